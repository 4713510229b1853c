"""Files of structures that were changed by hand or by a disk: used as they are, or refused."""

import json
import random
import warnings

import numpy as np
import pytest

import tiswarm as library
from tiswarm.base.errors import InputError
from tiswarm.base.robot import RobotGeometry
from tiswarm.records.io import DAMAGED
from tiswarm.world.history_file import from_arrays, read_history, to_arrays, write_history
from tiswarm.world.params import TowerParams


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Arrays of a file of two towers that lost robots."""
    structure = {"kind": "tower", "departures": {"rate": 0.4, "kind": "leave"}}
    found = library.grow(structure, robots=9, seeds=[0, 1], quiet=True)
    file = found.save(tmp_path_factory.mktemp("saved") / "whole.npz")
    with np.load(file) as entries:
        arrays = dict(entries)
    assert any(name.endswith("departures") for name in arrays)
    return arrays


def use(path):
    """Open structures and compute all that a caller may ask for."""
    found = library.open_swarms(path)
    for name in ("position", "orientation_wxyz", "sensed_load", "peak_stress", "join_round"):
        getattr(found, name)
    for name in ("leave_round", "departures", "is_gone", "flips", "contacts", "ground_docks"):
        getattr(found, name)
    for name in ("edge_docks", "stance_contacts", "stances", "growth", "table", "height", "seed"):
        getattr(found, name)
    logs = found.sense(tilt_noise_deg=1.0, yaw_noise_deg=1.0)
    assert all(np.isfinite(log.orientation_wxyz).all() for log in logs)
    assert str(found)
    return found


NUMBERS = (0, 1, -1, 2, 3, 8, 9, 999, -(2**31), 2**31 - 1, 1e5, 1e300, np.nan, np.inf, -np.inf)


def changed(array, rng):
    """Return an array with another number, shape or type."""
    array, way = array.copy(), rng.randrange(8)
    if array.dtype.kind == "U":
        return array
    if way <= 3 and array.size:
        number = rng.choice(NUMBERS)
        if array.dtype.kind != "f":
            number = int(np.clip(np.nan_to_num(number), -(2**31), 2**31 - 1))
        with np.errstate(all="ignore"):
            number = np.array([number]).astype(array.dtype, casting="unsafe")[0]
        array.reshape(-1)[rng.randrange(array.size)] = number
        return array
    if way == 4:
        return array[: rng.randrange(len(array) + 1)]
    if way == 5:
        return np.concatenate([array, array[-1:]]) if len(array) else array[..., None]
    if way == 6:
        with np.errstate(all="ignore"):
            return array.astype(rng.choice(["f4", "i8", "c16", "U9", "b1", "u2", ">i4", "i1"]))
    return rng.choice([array[None], array.reshape(-1), array[..., None], np.array(7), array[:0]])


def changed_facts(text, rng):
    """Return facts of which one has another value, type or name."""
    facts = json.loads(str(text))
    name = rng.choice([*facts])
    values = [-1, 2**63, 2**70, 1.5, float("nan"), float("inf"), None, "x", [], True]
    if rng.randrange(5) == 0:
        facts[f"{name}x"] = facts.pop(name)
    else:
        facts[name] = rng.choice(values)
    return np.array(json.dumps(facts))


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.trial) for k in range(1, 9))]
)
def test_a_damaged_file_is_used_or_refused(saved, tmp_path, seed):
    """A number out of place must not become a KeyError or NaN far from the file."""
    rng = random.Random(seed)  # noqa: S311 - no secrets
    path = tmp_path / "changed.npz"
    used, refusals = 0, list[str]()
    names = [name for name in saved if "/" in name]
    for name in names * 2:
        arrays = dict(saved)
        change = changed_facts if name.endswith("facts") else changed
        arrays[name] = change(arrays[name], rng)
        np.savez(path, **arrays)
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            try:
                use(path)
                used += 1
            except InputError as refusal:
                refusals.append(str(refusal))

    assert all(str(path) in refusal for refusal in refusals)
    assert len(refusals) > len(names)
    assert used > 0


PLACES = {
    "a contact with robot 999": ("contacts", (-1, 2), 999),
    "a contact of dock 7": ("contacts", (-1, 1), 7),
    "a contact with a later robot": ("contacts", (-1, 2), 8),
    "a contact at stance 5,000": ("contacts", (-1, 0), 5000),
    "a robot far away": ("center", (-1, 0), 1e5),
    "a robot moved by a tenth of its radius": ("center", (-1, 2), None),
    "a center without a number": ("center", (-1, 1), np.nan),
    "a quaternion of length 2": ("orientation_wxyz", (-1,), [2.0, 0.0, 0.0, 0.0]),
    "a pivot that is no dock": ("pivot_dock", (-1,), 3),
    "an infinite number of calls": ("strain", (-1, 2), np.inf),
    "a robot that joined at -3": ("round", (-1,), -3),
    "fewer rows than said": ("center_end", (-1,), 2),
    "a departure of robot 12": ("departures", (-1, 0), 12),
    "a departure of another kind": ("departures", (-1, 2), 5),
    "a departure before the first join": ("departures", (-1, 1), 0),
}


@pytest.mark.parametrize("name", PLACES)
def test_a_number_out_of_place_is_refused(saved, tmp_path, name):
    """The line names the file, whatever asks for the number later."""
    array, place, number = PLACES[name]
    number_of = next(key.partition("/")[0] for key in saved if key.endswith("/departures"))
    arrays = {key: values.copy() for key, values in saved.items()}
    values = arrays[f"{number_of}/{array}"]
    values[place] = values[place] + 0.1 if number is None else number
    np.savez(tmp_path / "s.npz", **arrays)

    with pytest.raises(InputError, match=r"s\.npz: is damaged; grow the structures again"):
        library.open_swarms(tmp_path / "s.npz")


def test_structures_of_other_numbers_are_refused(saved, tmp_path):
    """A structure that is missing, or has a name that is none, is damage."""
    for old, new in (("0/", "2/"), ("1/", "x/"), ("0/", "")):
        arrays = {key.replace(old, new, 1): values for key, values in saved.items()}
        np.savez(tmp_path / "s.npz", **arrays)

        with pytest.raises(InputError, match="is damaged"):
            library.open_swarms(tmp_path / "s.npz")


def test_a_kept_structure_with_a_fault_is_grown_again(towers, tmp_path):
    """A run that reads what an earlier one kept computes nothing from damage."""
    path = tmp_path / "seed-0.npz"
    write_history(towers[0], path)
    whole = read_history(path, TowerParams(), RobotGeometry())
    arrays = to_arrays(towers[0])
    arrays["center"][-1, 0] += 1e5
    np.savez(path, **arrays)

    assert whole is not None
    assert read_history(path, TowerParams(), RobotGeometry()) is None


def test_damage_is_of_kinds_that_readers_catch(towers):
    """No other exception comes from arrays of any type."""
    arrays = to_arrays(towers[0])

    for name in arrays:
        for value in (
            np.array(None),
            np.array(1j),
            np.array("x"),
            np.zeros((0, 0, 0)),
            np.array(7),
        ):
            with pytest.raises(DAMAGED):
                from_arrays({**arrays, name: value}, TowerParams(), RobotGeometry())
