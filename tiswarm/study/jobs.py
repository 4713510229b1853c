"""Jobs of a study: batches of its structures, whose robots grow and are localized together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from tiswarm.base.params import Arch
from tiswarm.study.cases import Case, Group
from tiswarm.study.store import RunFolder

ROBOTS_AT_ONCE = 10_000
"""A job has about this many robots at most, and is stored before the next."""

_JOBS_EACH = 4
"""Jobs for each process, so that all processes end at about the same time."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """Structures of one kind with their cases, and where to compute and store them."""

    structures: Sequence[Group]
    folder: RunFolder
    arch: Arch
    threads: int | None  # CPU threads; all if None

    @property
    def cases(self) -> list[Case]:
        """All cases, those of a structure side by side."""
        return [case for group in self.structures for case in group]

    @property
    def halves(self) -> "list[Job]":
        """The job in two parts, split between structures if it has several."""
        if middle := len(self.structures) // 2:
            parts = [self.structures[:middle], self.structures[middle:]]
        else:
            [group] = self.structures
            parts = [[group[: len(group) // 2]], [group[len(group) // 2 :]]]
        return [replace(self, structures=part) for part in parts]


def batch(
    structures: Sequence[Group],
    folder: RunFolder,
    *,
    arch: Arch,
    threads: int | None,
    width: int = 1,
    alone: bool = False,
) -> list[Job]:
    """Make jobs of structures: large ones, but enough to keep `width` processes busy.

    All cases of a structure are in the same job, so each structure is grown once. Each has a job of
    its own if they are to be `alone`.
    """
    robots_at_once = ROBOTS_AT_ONCE
    if width > 1:
        robots = sum(group[0].settings.robots for group in structures)
        robots_at_once = min(ROBOTS_AT_ONCE, robots // (_JOBS_EACH * width) + 1)
    jobs = []
    for _, alike in groupby(structures, key=lambda group: group[0].structure_key[:-1]):
        gathered: list[Group] = []
        robots = 0
        for group in alike:
            gathered.append(group)
            robots += group[0].settings.robots
            if alone or robots >= robots_at_once:
                jobs.append(gathered)
                gathered, robots = [], 0
        jobs += [gathered] if gathered else []
    return [Job(structures=job, folder=folder, arch=arch, threads=threads) for job in jobs]
