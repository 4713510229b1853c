"""What all robots of a swarm are programmed with; it says nothing of any robot."""

from dataclasses import dataclass
from functools import lru_cache

from tiswarm.localization.distributed import wire
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.records.sensing_format import HeaderLine, RobotLine
from tiswarm.records.sensing_log import LISTS


@dataclass(frozen=True, kw_only=True)
class AnswerSettings:
    """What is worth a message."""

    moved: float = 0.05
    """Shift from which on a robot hears where it is now [R]."""

    turned: float = 0.5
    """Turn from which on it does [standard deviations]."""

    shifted: float = 0.1
    """Shift from which on a branch does [R]."""

    stays_sd: float = 0.05
    """Standard deviation of each coordinate of a robot whose other rows are not here: the robots
    that solved for it know more of it [R]."""


ANSWERS = AnswerSettings()


@dataclass(frozen=True, eq=False)
class Program:
    """What every robot is programmed with; it says nothing of other robots."""

    params: DistributedParams
    header: HeaderLine
    """First line of a sensing file."""

    @property
    def docks(self) -> int:
        """Docks of a robot."""
        return len(self.header.dock_offsets)

    @property
    def exchanges(self) -> bool:
        """Whether candidates travel: who anneals finds other images without them."""
        return not self.params.chains

    def decoded(self, line: bytes) -> RobotLine:
        """Read a line as it was sent."""
        return _decoded(line, self.docks, self.params.bits)

    def partners(self, line: bytes) -> set[int]:
        """List the robots that a line has rows about."""
        entry = self.decoded(line)
        return {
            item[key.robot]
            for stance in (entry, *(entry.stances or []))
            for name, key in LISTS.items()
            if key.robot is not None
            for item in getattr(stance, name) or []
        }

    def touched(self, line: bytes) -> list[int]:
        """List the robots that a line has contacts with, by number; a dock may touch one again."""
        return sorted(robot for _, robot, _ in self.decoded(line).contacts)


@lru_cache(maxsize=20_000)
def _decoded(line: bytes, docks: int, bits: int | None) -> RobotLine:
    return wire.read_line(line, docks, bits)
