"""A function of the host inside a jitted CPU program, called by name.

`jax.pure_callback` puts the address of a Python object into the program, so JAX keeps none of its machine code and compiles it
again in every process. Here the program holds a name alone, which each process binds to its own function. The frame of a
call is that of XLA's FFI (xla/ffi/api/c_api.h in jaxlib/include; its layout holds for major version 0).
"""

import ctypes
from collections.abc import Callable
from ctypes import POINTER, c_char_p, c_int, c_int64, c_size_t, c_uint32, c_void_p
from typing import Any

import numpy as np

DTYPES = {11: np.dtype(np.float32), 12: np.dtype(np.float64)}  # XLA_FFI_DataType
METADATA = 1  # XLA_FFI_Extension_Type: asked once, when the name is bound
INTERNAL = 13  # XLA_FFI_Error_Code
_BOUND: dict[str, Any] = {}  # name -> its C function, which must outlive every program


def _struct(name: str, **fields) -> type[ctypes.Structure]:
    return type(name, (ctypes.Structure,), {"_fields_": list(fields.items())})


_HEAD = {"struct_size": c_size_t, "extension": c_void_p}
_Version = _struct("Version", **_HEAD, major=c_int, minor=c_int)
_Metadata = _struct("Metadata", struct_size=c_size_t, version=_Version, traits=c_uint32)
_Extension = _struct("Extension", struct_size=c_size_t, type=c_int, next=c_void_p, metadata=POINTER(_Metadata))
_Api = _struct("Api", **_HEAD, version=_Version, internal=c_void_p, create_error=c_void_p)
_Error = _struct("Error", **_HEAD, message=c_char_p, code=c_int)
_Buffer = _struct("Buffer", **_HEAD, dtype=c_int, data=c_void_p, rank=c_int64, dims=POINTER(c_int64))
_Buffers = _struct("Buffers", **_HEAD, size=c_int64, types=c_void_p, items=POINTER(POINTER(_Buffer)))
_Frame = _struct("Frame", **_HEAD, api=POINTER(_Api), context=c_void_p, stage=c_int, arguments=_Buffers, results=_Buffers)
_Handler = ctypes.CFUNCTYPE(c_void_p, POINTER(_Frame))
_CreateError = ctypes.CFUNCTYPE(c_void_p, POINTER(_Error))


def host_call(name: str, function: Callable, shape, *arguments):
    """As `jax.pure_callback(function, shape, *arguments, vmap_method="sequential")`, on the CPU.

    Args:
        name: says what `function` does, shapes included, in any process: the first function of a name is the one that is called.
        function: takes NumPy arrays that it must not change or keep, gives the result. Runs no JAX code.
        shape: jax.ShapeDtypeStruct of the result, float32 or float64, as the arguments.
    """
    import jax

    if name not in _BOUND:
        handler = _Handler(lambda frame: _answer(frame.contents, function))
        address = ctypes.cast(handler, c_void_p).value
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(address), platform="cpu")
        _BOUND[name] = handler
    return jax.ffi.ffi_call(name, shape, vmap_method="sequential")(*arguments)


def _answer(frame, function: Callable) -> int | None:
    """Serve one call; None, or the address of an XLA_FFI_Error."""
    if frame.extension:
        asked = ctypes.cast(frame.extension, POINTER(_Extension)).contents
        if asked.type == METADATA:
            version, known = asked.metadata.contents.version, frame.api.contents.version
            version.major, version.minor = known.major, known.minor
            return None
    try:
        arguments = [_array(frame.arguments.items[i].contents) for i in range(frame.arguments.size)]
        _array(frame.results.items[0].contents)[...] = function(*arguments)
    except BaseException as error:  # noqa: BLE001  nothing may leave through C: it would be lost, the result garbage
        api = frame.api.contents
        text = f"{type(error).__name__}: {error}".encode()
        return _CreateError(api.create_error)(_Error(ctypes.sizeof(_Error), None, text, INTERNAL))
    return None


def _array(buffer) -> np.ndarray:
    """A view of XLA's memory."""
    dtype, dims = DTYPES[buffer.dtype], buffer.dims[: buffer.rank]
    size = int(np.prod(dims)) * dtype.itemsize
    if not size:  # no address then
        return np.empty(dims, dtype)
    return np.frombuffer((ctypes.c_char * size).from_address(buffer.data), dtype).reshape(dims)
