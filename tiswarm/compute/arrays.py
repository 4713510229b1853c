"""Arrays that kernels work on: on the device, or on the host where that is the device too."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute.backend import Backend
from tiswarm.compute.lang import DeviceArray, ti

_KERNEL_TYPE = {np.float64: ti.f64, np.float32: ti.f32, np.int32: ti.i32}


@dataclass(frozen=True)
class Allocator:
    """Where arrays are reserved, and in which precision.

    A kernel starts sooner with arrays on the device, but these take longer to make: few starts
    are quicker with arrays on the host.
    """

    running: Backend
    """Backend whose kernels use the arrays."""

    on_host: bool
    """Whether arrays are NumPy's; the device is a CPU then."""

    def for_few_launches(self) -> "Allocator":
        """Return the allocator for arrays that few launches use."""
        return Allocator(self.running, on_host=self.running.arch == "cpu")

    def reals(self, *shape: int) -> DeviceArray:
        """Reserve an array of real numbers."""
        return self._reserve(self.running.dtype, shape)

    def ints(self, *shape: int) -> DeviceArray:
        """Reserve an array of integers."""
        return self._reserve(np.int32, shape)

    def upload(self, values: NDArray[Any]) -> DeviceArray:
        """Copy an array, in the precision of the backend if its numbers are real."""
        integer = np.issubdtype(values.dtype, np.integer)
        array = self.ints(*values.shape) if integer else self.reals(*values.shape)
        self.refill(array, values)
        return array

    def refill(self, array: DeviceArray, values: NDArray[Any]) -> None:
        """Copy values into an array that is there; reserving one takes a millisecond."""
        if self.on_host:
            array[...] = values
        else:
            real = array.dtype != ti.i32
            array.from_numpy(np.array(values, self.running.dtype if real else np.int32, order="C"))

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """Copy an array back to the host."""
        values: NDArray[Any] = array.copy() if self.on_host else array.to_numpy()
        return values

    def _reserve(self, dtype: type[np.generic], shape: tuple[int, ...]) -> DeviceArray:
        if self.on_host:
            return np.empty(shape, dtype)
        return ti.ndarray(_KERNEL_TYPE[dtype], shape)
