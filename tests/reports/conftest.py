"""What tests of reports share."""

import pytest
from browser import browser


@pytest.fixture(scope="module")
def page():
    """A page of a browser of its own."""
    with browser() as opened:
        yield opened
