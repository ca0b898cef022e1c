"""What the decision for a bag writer and reader of our own rests on (decision 13)."""

from pathlib import Path

import pytest

from koop_bench.bags import OPERATIONS, measure, worst_loss, write_source

SOURCE = Path(__file__).parents[2] / "benchmarks" / "bags.py"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    assert write_source(folder, 1000) == 4000
    return folder


def test_all_libraries_read_the_same_number_of_messages(folder):
    _, libraries = OPERATIONS["columns"]
    assert [measure(SOURCE, "columns", name, folder).messages for name in libraries] == [4000] * 3


def test_a_killed_writer_lacks_what_its_chunk_held_and_ours_is_bounded_in_time(folder):
    # 4 x 10 Hz: our chunk is closed after 0.1 s; a library's when it is full, and 4000 messages
    # fill less than one of 1 MiB
    ours, library = (worst_loss(SOURCE, name, folder, 10, (3333,)) for name in
                     ("koop_bag", "mcap_default"))  # fmt: skip
    assert ours <= 0.1 + 4 / 40  # the step that closes a chunk, and one
    assert library == pytest.approx(3333 / 40)
