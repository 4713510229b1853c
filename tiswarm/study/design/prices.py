"""Prices of settings, as users state them: a table `key,value,price`, or YAML by key and value."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from tiswarm.base.errors import InputError
from tiswarm.records.io import CsvFile
from tiswarm.records.messages import shown
from tiswarm.scenario.yaml_source import parse_yaml, read_yaml

COLUMNS = ("key", "value", "price")

_FORM = "write a mapping of prices by value below each key"


class Prices:
    """Prices by key and value; the price of a candidate is the sum over its keys."""

    def __init__(self, prices: Mapping[tuple[str, str], float], path: Path | None = None) -> None:
        """Take prices by key and value, the latter as `canonical` writes it."""
        self._prices = prices
        self._path = path

    @classmethod
    def read(cls, path: Path) -> "Prices":
        """Read a table (.csv) or YAML.

        Raises:
            InputError: the file cannot be read, a price is no number or below 0, or two are of the
                same value.
        """
        if path.suffix.lower() not in {".yaml", ".yml", ".json"}:
            return cls._of_table(path)
        source = read_yaml(path)
        if not isinstance(source.data, dict):
            raise InputError(f"is no mapping; {_FORM}", path=path, line=1)
        rows: list[tuple[str, object, object, int | None]] = []
        for key, values in source.data.items():
            line = source.position_of((key,)).line
            if not isinstance(values, dict):
                raise InputError(f"has no prices; {_FORM}", path=path, line=line, key=key)
            rows += [
                (key, parse_yaml(str(value)).data, price, source.position_of((key, value)).line)
                for value, price in values.items()
            ]
        return cls._of_rows(rows, path)

    @classmethod
    def of(cls, prices: Mapping[str, Mapping[object, float]]) -> "Prices":
        """Take prices by key and value, as `{"sensing.stances": {True: 2, False: 0}}`.

        Raises:
            InputError: a price is no number or below 0.
        """
        rows: list[tuple[str, object, object, int | None]] = []
        for key, values in prices.items():
            if not isinstance(values, Mapping):
                raise InputError(f"{key}: has no prices; {_FORM}", argument="prices")
            rows += [(key, value, price, None) for value, price in values.items()]
        return cls._of_rows(rows, None)

    @classmethod
    def _of_table(cls, path: Path) -> "Prices":
        table = CsvFile(path)
        lacking = [name for name in COLUMNS if name not in table.columns]
        if lacking:
            problem = f"there is no column {lacking[0]}; start the table with {','.join(COLUMNS)}"
            raise InputError(problem, path=path, line=1)
        keys, values = (table.words(name).tolist() for name in COLUMNS[:2])
        prices = table.numbers("price").tolist()
        rows: list[tuple[str, object, object, int | None]] = [
            (key.strip(), parse_yaml(value).data, price, table.line(row))
            for row, (key, value, price) in enumerate(zip(keys, values, prices, strict=True))
        ]
        return cls._of_rows(rows, path)

    @classmethod
    def _of_rows(
        cls, rows: Sequence[tuple[str, object, object, int | None]], path: Path | None
    ) -> "Prices":
        """Gather rows of key, value, price, and line in the file."""
        prices: dict[tuple[str, str], float] = {}
        for key, value, price, line in rows:
            name = (key, canonical(value))
            problem = ""
            is_number = isinstance(price, (int, float)) and not isinstance(price, bool)
            if not is_number or not 0.0 <= float(str(price)) < math.inf:
                problem = f"the price {shown(price)} should be a number from 0 up; correct it"
            elif name in prices:
                problem = f"{name[1]} has two prices; keep one"
            if problem:
                if path is None:
                    raise InputError(f"{key}: {problem}", argument="prices")
                raise InputError(problem, path=path, line=line, key=key)
            prices[name] = float(str(price))
        return cls(prices, path)

    def of_values(self, values: Mapping[str, object]) -> float:
        """Sum the prices of values by key.

        Raises:
            InputError: a value has no price.
        """
        total = 0.0
        for key, value in values.items():
            price = self._prices.get((key, canonical(value)))
            if price is None:
                problem = f"the value {canonical(value)} has no price; add one"
                if self._path is None:
                    raise InputError(f"{key}: {problem}", argument="prices")
                raise InputError(problem, path=self._path, key=key)
            total += price
        return total


def canonical(value: object) -> str:
    """Write a value so that equal ones have one text: 4 and 4.0, but not 1 and true."""
    return json.dumps(_with_floats(value), sort_keys=True)


def _with_floats(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _with_floats(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_with_floats(inner) for inner in value]
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value
