"""Table II of *Contact-Driven Localization in a Freeform Robotic Self-Assembled Structure*.

M. Rashidioun, M. Sosa, P. Swissler (2026); means over 25 structures of 100 robots. The paper does
not define its length unit, the "robot radius". It may be the radius R of a dock sphere, the
distance rho of a dock from the center, 1.506 R, or their sum. Ratios are stated for R and rho,
millimeters for none: the paper gives no length of a dock. The disparity has no unit.
"""

from typing import NamedTuple


class Published(NamedTuple):
    """The two numbers of one kind of structure and setting."""

    rmse_radii: float
    """Root mean square error ["robot radii"]."""

    disparity: float
    """Procrustes disparity [1]."""


PAPER_ROBOTS = 100
"""Robots in each structure of the paper."""

NOMINAL_RADIUS_MM = 32.9
"""Nominal radius of a dock, for exports in SI units alone [mm]; no dock was measured.

It is 54 / 1.64, the paper's "robot radius" in towers. In cantilevers that is 92 / 3.91, 23.5 mm.
"""

PAPER = {
    ("tower", True, True): Published(1.64, 0.045),
    ("tower", False, True): Published(1.84, 0.051),
    ("tower", False, False): Published(2.36, 0.066),
    ("cantilever", True, True): Published(3.91, 0.166),
    ("cantilever", False, True): Published(5.26, 0.219),
    ("cantilever", False, False): Published(5.12, 0.251),
}
"""Cells by kind of structure, `z_correction` and `undocked_repulsion`.

>>> PAPER["tower", True, True].rmse_radii
1.64
"""
