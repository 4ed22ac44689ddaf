"""Cache folders of machine code, so that a second run does not compile it again.

    FISHMJ_CACHE                  folder of fishmj's caches; default $XDG_CACHE_HOME/fishmj or ~/.cache/fishmj
    JAX_COMPILATION_CACHE_DIR     folder of JAX's cache; default the folder `jax` in it; set to nothing: JAX keeps nothing

JAX keeps programs that took a second or more to compile, keyed by everything that their machine code depends on, its own version
and the processor included. It keeps no program with a Python callback. Programs over the engine `compiled` call it by name
(engines/compiled.py) and are kept. All of it may be deleted at any time.
"""

import os
import sys
from pathlib import Path

JAX = "JAX_COMPILATION_CACHE_DIR"


def cache_folder() -> Path:
    """Folder for machine code and other results that are slow to make and may be lost."""
    chosen = os.environ.get("FISHMJ_CACHE")
    return Path(chosen) if chosen else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fishmj"


def keep() -> None:
    """Makes JAX keep its machine code, unless the user chose a folder or nothing can be written.

    JAX reads the environment on import. If it is imported already, its configuration is changed instead; programs that it
    compiled before are not kept.
    """
    jax = sys.modules.get("jax")
    if JAX in os.environ or getattr(getattr(jax, "config", None), "jax_compilation_cache_dir", None):
        return
    try:
        folder = cache_folder() / "jax"
    except RuntimeError:  # no home
        return
    there = next((parent for parent in (folder, *folder.parents) if parent.exists()), None)
    if there is not None and there.is_dir() and os.access(there, os.W_OK):
        os.environ[JAX] = str(folder)
        if jax is not None:
            from jax.experimental.compilation_cache.compilation_cache import reset_cache

            jax.config.update("jax_compilation_cache_dir", str(folder))
            reset_cache()  # after a first compilation JAX no longer looks where its programs are kept
