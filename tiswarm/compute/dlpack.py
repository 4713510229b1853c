"""Arrays on a graphics card for other libraries, by DLPack: they read the memory itself.

A capsule names the memory, its type and its shape, and has a function that its last user calls. See
https://dmlc.github.io/dlpack for the protocol and the layout of its structures.
"""

import ctypes
from typing import Any

import numpy as np

CPU = 1
CUDA = 2
"""Types of devices."""
_FLOAT = 2
"""Type of real numbers."""
_NAME = b"dltensor"
"""Name of a capsule that nobody has taken yet."""


class _Device(ctypes.Structure):
    _fields_ = (("type", ctypes.c_int32), ("number", ctypes.c_int32))


class _DataType(ctypes.Structure):
    _fields_ = (("code", ctypes.c_uint8), ("bits", ctypes.c_uint8), ("lanes", ctypes.c_uint16))


class _Tensor(ctypes.Structure):
    _fields_ = (
        ("data", ctypes.c_void_p),
        ("device", _Device),
        ("ndim", ctypes.c_int32),
        ("dtype", _DataType),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
        ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("byte_offset", ctypes.c_uint64),
    )


class _ManagedTensor(ctypes.Structure):
    _fields_ = (("tensor", _Tensor), ("context", ctypes.c_void_p), ("deleter", ctypes.c_void_p))


in_use: dict[int, tuple[object, ...]] = {}
"""What capsules need, by the address of their tensor."""


@ctypes.CFUNCTYPE(None, ctypes.c_void_p)
def _release(address: int) -> None:
    """Forget what a tensor needed; its last user calls this."""
    in_use.pop(address, None)


@ctypes.CFUNCTYPE(None, ctypes.c_void_p)
def _end_capsule(capsule: int) -> None:
    """Release the tensor of a capsule that nobody took."""
    if _is_valid(capsule, _NAME):
        in_use.pop(_pointer_of(capsule, _NAME), None)


# Functions of their own: those that `ctypes.pythonapi` has are shared, types of arguments included.
_new = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)(
    ("PyCapsule_New", ctypes.pythonapi)
)
_is_valid = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_char_p)(
    ("PyCapsule_IsValid", ctypes.pythonapi)
)
_pointer_of = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)


class ExportedArray:
    """Real numbers in memory that this program owns, row by row, for other libraries to read."""

    def __init__(
        self, address: int, shape: tuple[int, ...], dtype: np.dtype[Any], device: int, owner: object
    ) -> None:
        """Name memory of a device that lasts as long as its owner."""
        self.address = address
        self.shape = shape
        self.dtype = dtype
        self.device = device
        self.owner = owner

    def __dlpack_device__(self) -> tuple[int, int]:
        """Return type and number of the device."""
        return self.device, 0

    def __dlpack__(
        self,
        *,
        stream: object = None,
        max_version: object = None,
        dl_device: tuple[int, int] | None = None,
        copy: object = None,
    ) -> object:
        """Return a capsule; nothing is written there any more, so that any stream may read it.

        Raises:
            BufferError: another device is asked for.
        """
        del stream, max_version, copy
        if dl_device not in (None, self.__dlpack_device__()):
            raise BufferError(f"the array is on device {self.__dlpack_device__()}, not {dl_device}")
        shape = (ctypes.c_int64 * len(self.shape))(*self.shape)
        tensor = _Tensor(
            data=self.address,
            device=_Device(self.device, 0),
            ndim=len(self.shape),
            dtype=_DataType(_FLOAT, 8 * self.dtype.itemsize, 1),
            shape=shape,
        )
        release = ctypes.cast(_release, ctypes.c_void_p)
        managed = _ManagedTensor(tensor=tensor, deleter=release)
        address = ctypes.addressof(managed)
        in_use[address] = managed, shape, self.owner
        return _new(address, _NAME, ctypes.cast(_end_capsule, ctypes.c_void_p))
