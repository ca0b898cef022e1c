"""The page is one file."""

from importlib.resources import files

import pytest


@pytest.fixture(scope="module")
def page():
    return (files("koop_view") / "page" / "index.html").read_text(encoding="utf-8")


def test_the_page_is_installed(page):
    assert page.lower().startswith("<!doctype html>")
