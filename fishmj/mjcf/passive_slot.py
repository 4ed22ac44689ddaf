"""MuJoCo's slot for a passive-force callback, one a process, and MuJoCo's compiler, which fails while the slot is filled.

    install(callback) ... remove()      the slot belongs to this thread in between
    compiled(spec), xml_of(spec)        wait while another thread holds the slot; `install` waits for a running compiler

So one thread can step a fish while another builds models, without further coordination.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

from fishmj.base.errors import InjectionError

PATIENCE = 60.0  # s that a compiler waits for another thread's callback to go; a tick of a simulation takes milliseconds
_turn = threading.Condition()
_compilers = 0  # threads that compile or wait to; they go first, so that a thread that steps without a pause starves nobody
_owner: int | None = None  # the thread whose callback is installed


def install(callback) -> None:
    """Fills the slot for this thread. Raises InjectionError if it is filled already."""
    global _owner
    with _turn:
        if _owner not in (None, threading.get_ident()):
            raise InjectionError(
                "inject: the callback serves another thread; from threads take LinkWrench, Sim(injection='xfrc')"
            )
        _turn.wait_for(lambda: _compilers == 0)
        if mujoco.get_mjcb_passive() is not None:
            raise InjectionError("inject: mjcb_passive is taken by someone else; remove it first: mujoco.set_mjcb_passive(None)")
        mujoco.set_mjcb_passive(callback)
        _owner = threading.get_ident()


def remove() -> None:
    """Empties the slot."""
    global _owner
    with _turn:
        mujoco.set_mjcb_passive(None)
        _owner = None
        _turn.notify_all()


def taken_by_another_thread() -> bool:
    """Returns True if another thread has filled the slot."""
    return _owner not in (None, threading.get_ident())


@contextmanager
def kept_empty() -> Iterator[None]:
    """Context in which MuJoCo compiles: the slot is empty, and no thread fills it.

    Raises InjectionError: this thread or foreign code has filled the slot, or another thread does not empty it.
    """
    global _compilers
    with _turn:
        _compilers += 1
        try:
            _turn.wait_for(lambda: not taken_by_another_thread(), PATIENCE)
            if mujoco.get_mjcb_passive() is not None:
                raise InjectionError(
                    "mjcf.build: a passive-force callback is installed, and MuJoCo cannot compile a model meanwhile;"
                    " build the model before the inject block, or leave the inject block first"
                )
            yield
        finally:
            _compilers -= 1
            _turn.notify_all()


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Runs `spec.compile()` with an empty slot. Raises InjectionError as `kept_empty`. ValueError: MuJoCo cannot compile it."""
    with kept_empty():
        return spec.compile()


def xml_of(spec: mujoco.MjSpec) -> str:
    """Runs `spec.to_xml()`, which compiles too, with an empty slot; raises as `compiled`."""
    with kept_empty():
        spec.compile()
        return spec.to_xml()
