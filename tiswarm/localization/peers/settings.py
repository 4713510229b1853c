"""Methods by which rival systems, and general solvers, localize; here their settings."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from tiswarm.base.params import STRICT
from tiswarm.localization.settings import ChiSquareParams, CueParams, CuesOfNamedDocks


@dataclass(frozen=True, kw_only=True, config=STRICT)
class LeastSquaresParams(ChiSquareParams):
    """Starts from which the chi-square of all measurements is minimized."""

    module: ClassVar = "tiswarm.localization.peers.least_squares"

    method: Literal["least-squares"] = "least-squares"
    """Name of the method."""

    starts: Annotated[int, Field(ge=1, le=1000)] = 4
    """Starts from the positions of `hop-by-hop`, all but the first with random errors of its
    standard deviations, and as many from random directions of contacts. Where ranges tie robots,
    multidimensional scaling adds two more."""

    rounds: Annotated[int, Field(ge=1, le=1000)] = 50
    """Levenberg-Marquardt steps at most from each start."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class HopByHopParams(CueParams):
    """Order in which robots solve for their own positions, each once.

    Weights follow from the noise that the log states. Non-overlap decides between mirror images.
    """

    module: ClassVar = "tiswarm.localization.peers.hop_by_hop"

    method: Literal["hop-by-hop"] = "hop-by-hop"
    """Name of the method."""

    cues: CuesOfNamedDocks = CuesOfNamedDocks()
    """Cues in use, each of them on or off; all contacts name their docks."""

    order: Literal["hops", "join"] = "hops"
    """hops: a robot follows once its measurements of the world and of located robots, whether these
    joined earlier or later, suffice. join: robots follow in join order and use those before them.
    """
