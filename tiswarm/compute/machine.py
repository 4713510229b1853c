"""The machine that this process runs on, and its graphics cards.

Asks the driver which graphics card runs and how much memory is free, since the kernel library
does not pass that on.
"""

import ctypes
import functools
import os
import platform
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from tiswarm.base.params import Arch


def machine() -> dict[str, str | int | None]:
    """Return system, processor, cores and memory of this machine."""
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_MB": psutil.virtual_memory().total // 2**20,
    }


def _processor() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
        return platform.machine()
    return platform.processor()


_SUCCESS = 0
_CUDA_RATE = 87
"""CU_DEVICE_ATTRIBUTE_SINGLE_TO_DOUBLE_PRECISION_PERF_RATIO."""
_CUDA_MULTIPROCESSORS = 16
"""CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT."""
_HALF_RATE = 2

_PROPERTIES_BYTES = 4096
"""Room for VkPhysicalDeviceProperties: numbers, from the version to the type, then the name."""
_TYPE_AT = 16
_NAME_AT = 20
_IS_PROCESSOR = 4
"""VK_PHYSICAL_DEVICE_TYPE_CPU."""
_MOST_CARDS = 16


class Card(NamedTuple):
    """A graphics card, or a processor that stands in for one."""

    name: str

    driver: str
    """Version of the driver, or of the interface that it offers."""

    is_software: bool
    """Whether the processor does the work of a card; that is slower than the device cpu."""

    has_fast_f64: bool = False
    """Whether f64 takes at most twice the time of f32. Shaders of Vulkan lack its functions."""

    multiprocessors: int = 0
    """Parts that run blocks of threads by themselves; 0 where the driver does not say."""


class _VulkanInstance(ctypes.Structure):
    """VkInstanceCreateInfo."""

    _fields_ = (
        ("kind", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("application", ctypes.c_void_p),
        ("layers", ctypes.c_uint32),
        ("layer_names", ctypes.c_void_p),
        ("extensions", ctypes.c_uint32),
        ("extension_names", ctypes.c_void_p),
    )


@functools.cache
def find_card(arch: Arch) -> Card | None:
    """Ask the driver of CUDA or Vulkan for its card; None if it has none or cannot be asked."""
    with suppress(OSError, AttributeError):  # no driver, or one without these functions
        if arch == "cuda":
            return _cuda_card()
        if arch == "vulkan":
            return _vulkan_card()
    return None


def free_cuda_memory() -> int | None:
    """Ask how much memory of the first CUDA card is free [B]; None if it cannot be asked."""
    with suppress(OSError, AttributeError):
        cuda = ctypes.CDLL("libcuda.so.1")
        card = ctypes.c_int()
        context = ctypes.c_void_p()
        free = ctypes.c_size_t()
        total = ctypes.c_size_t()
        if cuda.cuInit(0) or cuda.cuDeviceGet(ctypes.byref(card), 0):
            return None
        if cuda.cuDevicePrimaryCtxRetain(ctypes.byref(context), card) != _SUCCESS:
            return None
        cuda.cuCtxPushCurrent_v2(context)
        status = cuda.cuMemGetInfo_v2(ctypes.byref(free), ctypes.byref(total))
        cuda.cuCtxPopCurrent_v2(ctypes.byref(context))
        cuda.cuDevicePrimaryCtxRelease_v2(card)
        return free.value if status == _SUCCESS else None
    return None


def _cuda_card() -> Card | None:
    cuda = ctypes.CDLL("libcuda.so.1")
    card = ctypes.c_int()
    if cuda.cuInit(0) or cuda.cuDeviceGet(ctypes.byref(card), 0):
        return None
    name = ctypes.create_string_buffer(256)
    version = ctypes.c_int()
    cuda.cuDeviceGetName(name, len(name), card)
    cuda.cuDriverGetVersion(ctypes.byref(version))
    facts = []
    for attribute in (_CUDA_RATE, _CUDA_MULTIPROCESSORS):
        value = ctypes.c_int()
        cuda.cuDeviceGetAttribute(ctypes.byref(value), attribute, card)
        facts.append(value.value)
    return Card(
        name=name.value.decode(errors="replace"),
        driver=f"CUDA {version.value // 1000}.{version.value % 1000 // 10}",
        is_software=False,
        has_fast_f64=0 < facts[0] <= _HALF_RATE,
        multiprocessors=facts[1],
    )


def _vulkan_card() -> Card | None:
    """Return the first card that is none of software, if there is one, else the software."""
    vulkan = ctypes.CDLL("libvulkan.so.1")
    instance = ctypes.c_void_p()
    wanted = _VulkanInstance(kind=1)
    if vulkan.vkCreateInstance(ctypes.byref(wanted), None, ctypes.byref(instance)) != _SUCCESS:
        return None
    count = ctypes.c_uint32(_MOST_CARDS)
    handles = (ctypes.c_void_p * _MOST_CARDS)()
    vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
    cards = []
    for handle in handles[: count.value]:
        facts = ctypes.create_string_buffer(_PROPERTIES_BYTES)
        vulkan.vkGetPhysicalDeviceProperties(ctypes.c_void_p(handle), facts)
        version, kind = np.frombuffer(facts.raw, np.uint32)[[0, _TYPE_AT // 4]].tolist()
        cards.append(
            Card(
                name=ctypes.string_at(ctypes.byref(facts, _NAME_AT)).decode(errors="replace"),
                driver=f"Vulkan {version >> 22}.{version >> 12 & 0x3FF}",
                is_software=kind == _IS_PROCESSOR,
            )
        )
    vulkan.vkDestroyInstance(instance, None)
    return min(cards, key=lambda card: card.is_software, default=None)
