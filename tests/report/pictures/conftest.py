"""The run folder of tests of reports."""

from tests.report.conftest import run_folder  # noqa: F401 - a fixture
