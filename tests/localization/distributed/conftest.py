"""Structures as tests of methods have them."""

from tests.localization.conftest import tall_towers, towers  # noqa: F401 - fixtures
