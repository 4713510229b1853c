"""Least squares from several starts: the minimum of the chi-square of all measurements.

Robots that solve for themselves, one after the other, end near the minimum where measurements
suffice; where they do not, all of them follow from directions of contacts drawn at random. From
there all move at once, by the same steps as at the end of `joint`. Starts differ by random errors,
so that the estimate says whether they lead to one minimum. Lengths in R.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tiswarm.base.aliases import Reals
from tiswarm.base.progress import ignore
from tiswarm.compute.math import normal
from tiswarm.localization.chains.annealer import Annealed
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.chains.views import set_apart
from tiswarm.localization.mixture.assessment import open_variance
from tiswarm.localization.mixture.coarse import coarse_starts
from tiswarm.localization.mixture.common_causes import with_common_causes
from tiswarm.localization.mixture.ends import Fit, Posed, further_starts, settled
from tiswarm.localization.mixture.mixture import mixed
from tiswarm.localization.mixture.verdict import widened
from tiswarm.localization.peers.hop_by_hop import place
from tiswarm.localization.peers.settings import LeastSquaresParams
from tiswarm.localization.settings import DOCKS_UNKNOWN
from tiswarm.measurements.cues import Precision, measure
from tiswarm.measurements.equations import AXES
from tiswarm.measurements.model import SPACING
from tiswarm.records.estimate import Estimate
from tiswarm.records.sensing_log import SensingLog

_AXIS = np.arange(AXES)

_CAUTION = 3.0
"""Factor of `sd` where an estimate is not trusted. `sd` is that of the minima found, and a search
from few starts may miss the least one. On 139 training logs, 1 of 254 robots that are said to be
within R are then off where no measurement is wrong; 11 of 420 without it."""


def localize(
    log: SensingLog,
    params: LeastSquaresParams,
    _on_progress: Callable[[float], None] = ignore,
) -> Estimate:
    """Localize a structure.

    Returns:
        Its estimate: the mean over all minima found, weighted as in `joint`. `sd` follows from
        their curvature; where measurements leave motions open, it is that of `hop-by-hop`. That of
        an estimate that is not trusted is larger. The residual is the root mean square over
        contacts, ranges, and the components of measured offsets.
    """
    estimate = _localized(log, params)
    posed = Posed(log, params, pose_problem(log, params))
    with_causes = with_common_causes(posed, estimate, lambda changed: _localized(changed, params))
    return _cautious(with_causes or estimate)


def _cautious(estimate: Estimate) -> Estimate:
    """Widen the sd of an estimate that is not trusted, since the least minimum may be elsewhere."""
    verdict = estimate.convergence
    if verdict is None or verdict.trusted or estimate.sd is None:
        return estimate
    return replace(
        estimate,
        sd=widened(estimate.sd, _CAUTION, estimate.position),
        convergence=replace(verdict, sd_factor=_CAUTION * verdict.sd_factor),
    )


def _localized(log: SensingLog, params: LeastSquaresParams) -> Estimate:
    """Localize a log without a search for what is wrong in it."""
    posed = Posed(log, params, pose_problem(log, params))
    precision = Precision(params.contact_sd, params.height_sd, params.spawn_sd)
    rows = measure(
        log, [cue for cue in params.used_cues if cue not in DOCKS_UNKNOWN], precision=precision
    )
    placed = place(log, rows, non_overlap=params.cues.non_overlap)
    position = set_apart(posed.problem, placed.position)
    starts = [
        *_starts(position, placed.sd, params),
        *coarse_starts(posed.problem, position[0], params.seed, params.starts),
        *further_starts(posed),
    ]
    ends = [settled(posed, start, 0.0, params.rounds) for start in starts]
    end = np.array([center for center, _, _ in ends])
    yaw = np.array([turn for _, turn, _ in ends])
    still = Annealed(
        mean=end,
        within=np.zeros(end.shape[:2]),
        last=end,
        mean_yaw=yaw,
        last_yaw=yaw,
        sigma=0.0,
        temperature=np.ones(len(end)),
        iteration=_AXIS[:2],
        trace=np.stack([position, end[0]]),
        yaw_trace=np.stack([np.zeros_like(yaw[0]), yaw[0]]),
    )
    # Measurements decide where robots are that they determine; partners, where others are.
    extent = float(np.sqrt(position.var(axis=0).sum() + SPACING**2))
    inlier = np.ones(len(posed.problem.rows), np.bool_)
    left_open = open_variance(posed, (end[0], yaw[0]), inlier)
    prior_sd = np.where(placed.is_located, extent, np.maximum(placed.sd, np.sqrt(left_open)))
    fit = Fit(log, params, posed.problem, still, np.zeros(len(end), np.bool_))
    return mixed(fit, prior_sd=prior_sd)


def _starts(position: Reals, sd: Reals, params: LeastSquaresParams) -> Reals:
    """Add random errors to positions: none at first, at last of their `sd`, (starts, N, 3)."""
    draw = 3 * np.arange(params.starts)[:, None, None] + _AXIS
    robot = np.arange(len(sd))[:, None]
    size = np.linspace(0.0, np.sqrt(1.0 / 3.0), params.starts)[:, None, None] * sd[:, None]
    size[:, 0] = 0.0
    moved: Reals = position + size * normal(params.seed, "starts", robot, draw)
    return moved
