"""What a user may choose to compute on; free of the kernel library, so cheap to import."""

from typing import Literal, get_args

Arch = Literal["cpu", "cuda", "vulkan", "metal"]
Precision = Literal["f64", "f32"]
ARCHS: tuple[Arch, ...] = get_args(Arch)
