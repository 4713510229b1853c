"""What a study may ask: its result in one sentence answers it."""

from typing import Annotated, Literal

from pydantic import Field

AnyQuestion = Literal["least-error", "reached", "traffic", "cues", "scaling"]
"""Names of questions; `tiswarm.report.answers` has a function for each that answers it."""

Question = Annotated[
    AnyQuestion,
    Field(
        description="What the last line of `run` and the first line of the page answer. "
        "`least-error`: mean RMSE of conditions with equal measurements. `reached`: heights, "
        "reaches and depths of structures, and bridges closed. `traffic`: RMSE of methods whose "
        "robots send at most 1 kB each. `cues`: RMSE as cues are left out. `scaling`: exponents of "
        "RMSE and CPU time against the number of robots. A question that the results cannot answer "
        "counts as `least-error`."
    ),
]
"""A question as a key of a scenario."""
