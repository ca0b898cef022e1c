"""Where CONTRIBUTING.md says that something is, it is."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
ROWS = re.findall(r"^\| (.+\?) \| `(\S+)` \| (.+) \|$", TEXT, re.MULTILINE)


def test_ten_questions_and_more_are_answered():
    assert len(ROWS) >= 10
    assert len(ROWS) == TEXT.count("? |")


@pytest.mark.parametrize(
    ("file", "symbols"), [row[1:] for row in ROWS], ids=lambda text: text[-40:]
)
def test_the_answer_stands_in_the_file(file, symbols):
    path = ROOT / file
    assert path.exists()
    for symbol in re.findall(r"`(\w+)`", symbols):
        definition = rf"^((async )?def |class )?{symbol}\b *[(:=]"
        assert re.search(definition, path.read_text(), re.MULTILINE), symbol
