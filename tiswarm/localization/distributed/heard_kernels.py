"""A step of robots that anneal at once, each by what it heard last of the others. Lengths in R.

A robot sends its position as it steps, at a time of its own in each round. Messages of a round come
`hops` rounds later, or `delay` more for each hop, at the same time in their round.
"""

from typing import NamedTuple

from tiswarm.compute.lang import F64, I32, Ints1, Ints2, Reals2, Reals3, Ref, ti
from tiswarm.compute.math_kernels import kick_of, vector_at
from tiswarm.localization.distributed.chain_kernels import ChainDocks, ChainRows, force_on, moved

TIME = 3
"""Column after a position that has the time of its round at which it was sent."""

SENT = 4
"""Columns of a message."""

_CLOCK = -2
"""Robot, in the draw of a time, that no loss has."""


class Hearing(NamedTuple):
    """What N robots sent each other, and what each heard."""

    hops: Ints2
    """Transmissions from one robot to another, 0 to itself and where there is no way, (N, N)."""

    sent: Reals3
    """Messages of the last rounds, as rounded, shape (rounds, N, SENT)."""

    view: Reals3
    """Where each robot takes the others to be [R], shape (N, N, 3)."""


@ti.func
def _chance(seed, i, j, t):
    """Draw a number in (0, 1) for what robot i hears of j in a round."""
    # Kicks of steps have the chain 0; those of robots have a width of the square root of 12.
    return kick_of(seed, i + 1, j, t)[0] / ti.sqrt(12.0) + 0.5


@ti.func
def _hear(seed, i, t, loss, delay, hearing: Ref):
    """Take in what robot i heard until it steps in round t; return the time at which it does."""
    rounds = hearing.sent.shape[0]
    now = _chance(seed, _CLOCK, i, t)
    for j in range(hearing.sent.shape[1]):
        hops = hearing.hops[i, j]
        if hops > 0:
            sent = t - hops * (1 + delay)
            if sent >= 0 and hearing.sent[sent % rounds, j, TIME] >= now:
                sent -= 1  # that of this round is still to come
            if sent >= 0 and _chance(seed, i, j, sent) < (1.0 - loss) ** hops:
                for a in ti.static(range(3)):
                    hearing.view[i, j, a] = hearing.sent[sent % rounds, j, a]
    return now


@ti.func
def rounded(value, farthest, bits):
    """Round to one of 2^bits values up to the least power of two that none exceeds; 0 for all."""
    if bits > 0:
        limit = 1.0
        while limit < farthest:
            limit *= 2.0
        step = 2.0 * limit / (2.0**bits - 1.0)
        value = ti.round((value + limit) / step) * step - limit
    return value


@ti.kernel
def step_as_heard(
    seed: I32, t: I32, counts: I32, sigma: F64, memory: F64, reach: F64,
    loss: F64, delay: I32, bits: I32,
    start: Ints1, partner: Ints1, arm: Reals2, axis: Reals2, value: Reals2,  # ChainRows
    offset: Reals3, touch_start: Ints1, contact: Ints2,  # ChainDocks
    hops: Ints2, sent_out: Reals3, view_out: Reals3,  # Hearing
    place_out: Reals2, speed_out: Reals2, total_out: Reals2,
):  # fmt: skip
    """Let N robots hear, step and send. The first one is the anchor, and stays.

    Args:
        seed: Seed of kicks, losses and times.
        t: Number of the round.
        counts: Whether positions enter the mean.
        sigma: Square root of the temperature [R].
        memory: What friction leaves of a velocity in a step.
        reach: Distance of centers below which docks may overlap [R].
        loss: Share of transmissions that are lost.
        delay: Rounds that one takes beyond the next.
        bits: Bits of a number; 0 if none is rounded.
        place_out: Where each robot takes itself to be [R], shape (N, 3).
        speed_out: Velocities, shape (N, 3).
        total_out: Sums of positions, shape (N, 3).
    """
    rows = ti.static(ChainRows(start, partner, arm, axis, value))
    docks = ti.static(ChainDocks(offset, touch_start, contact))
    hearing = ti.static(Hearing(hops, sent_out, view_out))
    for i in range(place_out.shape[0]):
        now = _hear(seed, i, t, loss, delay, hearing)
        here = vector_at(place_out, i)
        if i > 0:
            force, mass = force_on(
                i, i, here, place_out.shape[0], reach, sigma * sigma, rows, docks, view_out
            )
            kick = kick_of(seed, 0, i, t)
            slow, way = moved(sigma, force, mass, kick, vector_at(speed_out, i), memory)
            here += way
            for a in ti.static(range(3)):
                speed_out[i, a] = slow[a]
                place_out[i, a] = here[a]
        farthest = ti.abs(here).max()
        for a in ti.static(range(3)):
            total_out[i, a] += counts * here[a]
            sent_out[t % sent_out.shape[0], i, a] = rounded(here[a], farthest, bits)
        sent_out[t % sent_out.shape[0], i, TIME] = now
