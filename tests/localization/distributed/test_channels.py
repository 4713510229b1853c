"""A channel decides who hears what, by chance, in bursts, by collisions, or as a plug-in does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.runs import call
from tiswarm.base import plugins
from tiswarm.base.errors import InputError
from tiswarm.localization.distributed.channel import Channel, Message
from tiswarm.localization.distributed.channels import Air, Lossy
from tiswarm.localization.distributed.settings import DistributedParams
from tiswarm.localization.settings import BackPropagation

PUBLISHED = {"scheme": "algorithm-1", "channel": "radio"}
PAIR = np.zeros(1, np.int64), np.ones(1, np.int64), np.full(1, 20)


def _losses(loss, burst, rounds, seed=0, every=1):
    """Which rounds one link loses, when it is used each `every` rounds."""
    medium, rng = Lossy(loss, burst), np.random.default_rng(seed)
    return np.array([
        not medium.hear(Air(n, *PAIR, rng.random(1), rng.random(1), is_answer=False))[0]
        for n in range(0, every * rounds, every)
    ])  # fmt: skip


def _bursts(lost):
    """Lengths of runs of losses that begin and end within the rounds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], lost, [0]]).astype(int)))
    return (edges[1::2] - edges[::2])[1:-1]


@pytest.mark.parametrize(("loss", "burst"), [(0.1, 4.0), (0.3, 8.0), (0.3, 1.0 / 0.7)])
def test_losses_of_a_link_are_those_of_two_states(loss, burst):
    """Share and mean length of bursts are those asked for, within four standard errors.

    Losses n rounds apart correlate as (1 - p - q)^n, p and q the chances of a change of state, so
    the mean of N of them has the variance loss (1 - loss) (1 + k) / (1 - k) / N, k = 1 - p - q.
    Lengths of bursts are geometric.
    """
    rounds = 30_000
    lost = _losses(loss, burst, rounds)

    kept = 1.0 - 1.0 / burst - loss / (burst * (1.0 - loss))
    sd = np.sqrt(loss * (1.0 - loss) * (1.0 + kept) / (1.0 - kept) / rounds)
    assert abs(lost.mean() - loss) < 4.0 * sd
    lengths = _bursts(lost)
    sd = np.sqrt(burst * (burst - 1.0) / len(lengths))
    assert abs(lengths.mean() - burst) < 4.0 * sd


def test_links_change_while_nobody_uses_them():
    """Seen every third round, two losses in a row have the chance of three rounds of two states."""
    loss, burst = 0.3, 6.0
    lost = _losses(loss, burst, 20_000, every=3)

    change = np.array([[1.0 - 1.0 / burst, 1.0 / burst], [0.0, 0.0]])
    change[1] = loss / (burst * (1.0 - loss)), 1.0 - loss / (burst * (1.0 - loss))
    expected = np.linalg.matrix_power(change, 3)[0, 0]
    again = lost[1:][lost[:-1]]
    assert abs(again.mean() - expected) < 4.0 * np.sqrt(expected * (1 - expected) / len(again))


def test_a_link_is_in_one_state_within_a_round():
    """Two transmissions of a round over one link are both lost, or both heard."""
    medium, rng = Lossy(0.5, 5.0), np.random.default_rng(1)
    two = [np.repeat(each, 2) for each in PAIR]
    for n in range(200):
        heard = medium.hear(Air(n, *two, rng.random(2), rng.random(2), is_answer=False))
        assert heard[0] == heard[1]


@settings(max_examples=40)
@given(
    slots=st.integers(1, 6),
    senders=st.lists(st.integers(0, 5), min_size=1, max_size=6, unique=True),
    seed=st.integers(0, 1_000),
)
def test_a_listener_hears_who_is_alone_in_a_slot(slots, senders, seed):
    """Counted out robot by robot: two in a slot are lost, and who transmits in it hears nothing."""
    chance = np.random.default_rng(seed).random(6)
    pairs = [(i, j) for i in senders for j in range(6) if i != j]
    sender, listener = np.array(pairs).T
    size, own = np.full(len(pairs), 9), chance[sender]

    heard = Lossy(0.0, None, slots).hear(
        Air(1, sender, listener, size, np.ones(len(pairs)), own, is_answer=False)
    )

    slot = {i: int(chance[i] * slots) for i in senders}
    for (i, j), is_heard in zip(pairs, heard.tolist(), strict=True):
        others = [k for k in senders if k != i and slot[k] == slot[i]]
        assert is_heard == (not others)  # all are in reach of each other
        assert not (is_heard and j in others)


def _sent(params, links, receivers):
    """Send a message from robot 0, and list who takes it in, with the parts that each sees."""
    heard = {}

    def hear(number, message):
        heard.setdefault(number, []).append(dict(message.parts))
        return message

    channel = Channel(params, hear)
    for touching in links:
        channel.join(touching)
    channel.send(Message("place", 0, b"\0", {each: bytes([each]) for each in receivers}))
    channel.settle()
    return heard, channel


TREES = st.integers(2, 9).flatmap(
    lambda n: st.tuples(
        st.tuples(*(st.sets(st.integers(0, i - 1), min_size=1) for i in range(1, n))),
        st.sets(st.integers(1, n - 1), min_size=1),
    )
)


@settings(max_examples=60)
@given(
    TREES,
    st.sampled_from([
        {}, {"channel": "radio"}, {"channel": "radio", "radio_reach": "ranged"},
        {"channel": "radio", "radio_reach": "ranged", "slots": 1000}, {"delay": 3},
        {"loss": 0.2, "retries": 100}, {"loss": 0.3, "burst": 3.0, "retries": 100},
    ]),
)  # fmt: skip
def test_what_is_not_lost_arrives_once(tree, given_settings):
    """Each receiver in the swarm takes a message in once, with its own part in it."""
    links, receivers = tree
    heard, channel = _sent(DistributedParams(**given_settings), [set(), *links], receivers)

    assert receivers <= heard.keys()
    assert all(len(times) == 1 for times in heard.values())
    assert all(heard[each][0][each] == bytes([each]) for each in receivers)
    assert min(channel.sent) >= 0


@pytest.mark.parametrize("delay", [0, 3])
def test_what_nobody_acknowledges_is_repeated_after_pauses_that_double(delay):
    """Repetition k comes 2^k rounds after the last one, and the delay, so it outlasts a burst."""
    heard = []
    channel = Channel(DistributedParams(delay=delay, retries=5), lambda _, message: message)
    channel.join(set())
    channel.join({0})

    def hear(now, sender, *_):
        heard.append(now)
        return np.zeros(len(sender), np.bool_)

    channel._hears = hear  # noqa: SLF001 - a channel that loses all
    channel.send(Message("place", 0, b"", {1: b""}))
    channel.settle()

    assert np.diff(heard).tolist() == [2 + delay, 4 + delay, 8 + delay, 16 + delay, 32 + delay]
    assert channel.messages == [6, 0]


def test_a_radio_of_limited_reach_relays():
    """Of a row of four robots each hears its neighbors; two of them pass the message on."""
    params = DistributedParams(channel="radio", radio_reach="ranged")
    heard, channel = _sent(params, [set(), {0}, {1}, {2}], {3})

    assert sorted(heard) == [1, 2, 3]
    assert channel.messages == [1, 1, 1, 0]
    # A header, a common byte and a part of one; a robot in between hears it twice.
    size, answer = 4 + 1 + 2 + 1, 3
    assert channel.sent == [size, size + answer, size + answer, answer]
    assert channel.heard == [size + answer, 2 * size + answer, size + answer, size]


@pytest.mark.parametrize(
    ("given_settings", "problem"),
    [
        ({"loss": 0.5, "burst": 1.5}, "burst 1.5 is shorter than without bursts, 2 at loss 0.5"),
        ({"slots": 8}, "slots is of radio"),
        ({"radio_reach": "ranged"}, "radio_reach is of radio"),
        ({"scheme": "algorithm-1", "burst": 3.0}, "burst of algorithm-1 is of radio"),
        ({"scheme": "algorithm-1", "delay": 3}, "delay is of scheme joiner"),
        ({"scheme": "algorithm-1", "routes": "learned"}, "routes is of scheme joiner"),
        ({"routes": "learned", "channel": "radio"}, "needs robots that pass messages on"),
        (
            PUBLISHED | {"poses": "once", "loss": 0.1},
            "poses once needs all poses, and channel radio loses some; remove loss",
        ),
        (
            PUBLISHED | {"slots": 9, "back_propagation": BackPropagation()},
            "back_propagation needs all poses",
        ),
    ],
)
def test_settings_without_effect_are_refused(given_settings, problem):
    """Each message says what to do."""
    with pytest.raises(ValueError, match=problem):
        DistributedParams(**given_settings)


OWN = """
import tiswarm

@tiswarm.channel("{name}")
def hear(air, settings):
    return {heard}
"""
SMALL = [
    "robots=5", "seeds=1", "conditions={own: {}}",
    "localization={method: distributed, channel: deaf-to-3, chains: 0}",
]  # fmt: skip


def _run(folder, heard, name="deaf-to-3"):
    (folder / "own.py").write_text(OWN.format(name=name, heard=heard))
    sets = [each for text in SMALL for each in ("--set", text)]
    return call(
        "run", "tower", "--plugin", "own.py", *sets, "--no-pictures", "--out", "runs", cwd=folder
    )


def test_a_plugin_decides_who_hears(tmp_path):
    """It is asked about each round, answers included; who does not hear passes nothing on."""
    (tmp_path / "own.py").write_text(OWN.format(name="deaf-to-2", heard="air.listener != 2"))
    plugins.load_plugins([tmp_path / "own.py"])
    try:
        params = DistributedParams(channel="deaf-to-2", radio_reach="ranged")
        heard, channel = _sent(params, [set(), {0}, {1}, {2}], {3})
    finally:
        plugins.forget()

    assert sorted(heard) == [1]
    assert channel.messages == [1, 1 + params.retries, 0, 0]


@pytest.mark.trial
def test_a_channel_of_a_plugin_is_chosen_by_its_name(tmp_path):
    """Robot 3 hears nothing, not even answers; all others know where they are."""
    done = _run(tmp_path, "(air.listener != 3) & (air.sender != 3)")

    assert done.returncode == 0, done.stderr
    [table] = tmp_path.glob("runs/*/cases/*/robots.csv")
    heard = np.genfromtxt(table, delimiter=",", names=True)["heard_B"]
    assert heard[3] == 0
    assert np.delete(heard, 3).min() > 0
    [record] = tmp_path.glob("runs/*/cases/*/case.json")
    assert '"code": "' in record.read_text()
    assert "+" in record.read_text().partition('"code": "')[2].partition('"')[0]


@pytest.mark.trial
@pytest.mark.parametrize("heard", ["air.chance", "[True]", "1 / 0"])
def test_a_mistake_in_a_channel_is_a_line(tmp_path, heard):
    """It names the file of the plug-in."""
    done = _run(tmp_path, heard)

    assert done.returncode != 0
    assert "own.py" in done.stderr + done.stdout
    assert "Traceback" not in done.stderr


@pytest.mark.trial
def test_a_name_of_the_package_is_taken(tmp_path):
    """A plug-in that is called touch would hide the channel of the package."""
    done = _run(tmp_path, "air.chance >= 0", name="touch")

    assert done.returncode == 2
    assert "channel touch is taken by tiswarm itself" in done.stderr


def test_a_channel_that_nobody_registered_is_a_line():
    """The message lists those there are."""
    with pytest.raises((ValueError, InputError), match="touch"):
        DistributedParams(channel="smoke")


@pytest.mark.parametrize("retries", [0, 1, 4])
def test_lost_messages_by_touch_are_counted_with_all_repetitions(retries):
    """Half of all transmissions and half of their acknowledgments are lost: 3 of 4 fail."""
    channel = Channel(DistributedParams(loss=0.5, retries=retries), lambda _number, heard: heard)
    for links in (set(), {0}):
        channel.join(links)
    expected = sum(0.75**earlier for earlier in [*range(retries), retries])

    channel.answer(0, 2**20)

    assert channel.sent[1] == round(expected * 2**20)
