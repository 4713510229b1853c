"""Whether a change of the code leaves the results of the shipped scenarios as they were.

    python -m benchmarks.result_bytes --store before.json      # run all, keep the digests
    python -m benchmarks.result_bytes --against before.json    # again; status 1 if a file differs
    python -m benchmarks.result_bytes --scenarios joint online --against before.json

A scenario runs with few robots, one seed and the first entries of its sweep, with all conditions.
Digests are of the files of each case that state results, not times: logs, truth, estimates, errors
and residuals. They hold on one kind of processor with one set of libraries.
"""

import argparse
import hashlib
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import yaml

import tiswarm
from tiswarm.scenario.yaml_source import shipped_scenarios

ROBOTS = 12
"""Robots of a structure at small size; enough for walks, loads and recruits."""
ENTRIES = 2
"""Entries of each list of a sweep that are run."""
FILES = ("sensing.jsonl", "truth.csv", "estimate.csv", "robots.csv", "convergence.csv")
"""Files of a case whose bytes are results."""


def shrink(scenario: dict[str, Any]) -> dict[str, Any]:
    """Return a scenario with few robots, one seed and the first entries of its sweep."""
    small = scenario | {"robots": ROBOTS, "seeds": 1}
    sweep = {key: values[:ENTRIES] for key, values in scenario.get("sweep", {}).items()}
    sweep = {key: values for key, values in sweep.items() if "robots" not in key.split(", ")}
    small["sweep"] = sweep
    if "structure" in scenario:  # studies of the engine have none
        structure = scenario["structure"]
        small["structure"] = {**structure, "movers": min(structure.get("movers", 1), 4)}
    return small


def digests(name: str, path: Path, folder: Path) -> dict[str, str]:
    """Run a scenario at small size in a folder and digest the result files of its cases."""
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump(shrink(yaml.safe_load(path.read_text())), sort_keys=False))
    run = tiswarm.run(file, out=folder / name)
    cases = run.folder / "cases"
    files = sorted(file for file in cases.rglob("*") if file.name in FILES)
    return {
        f"{name}/{file.relative_to(cases)}": hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
    }


def main() -> int:
    """Run the scenarios, then store or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenarios", nargs="*", default=sorted(shipped_scenarios()))
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--store", type=Path)
    action.add_argument("--against", type=Path)
    options = parser.parse_args()
    now: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in options.scenarios:
            start = time.process_time()
            now |= digests(name, shipped_scenarios()[name], Path(folder))
            print(f"{name}: {time.process_time() - start:.1f} CPU s", file=sys.stderr)
    if options.store:
        options.store.write_text(json.dumps(now, indent=1))
        print(f"{len(now)} files of {len(options.scenarios)} scenarios")
        return 0
    names = tuple(f"{name}/" for name in options.scenarios)
    before = {
        name: digest
        for name, digest in json.loads(options.against.read_text()).items()
        if name.startswith(names)
    }
    differ = sorted(name for name in before.keys() | now if before.get(name) != now.get(name))
    print("\n".join(differ) or f"{len(now)} files are equal to the byte")
    return bool(differ)


if __name__ == "__main__":
    sys.exit(main())
