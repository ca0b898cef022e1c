"""Messages in time order, and the words of a playback."""

import math
import random

import pytest

from koop_bag.bag.playback import in_time_order
from koop_bag.bag.reader import RawMessage
from koop_bag.player.config import PlayerConfig
from koop_core.config.parameter import ConfigError

BEGIN = 1_700_000_000_000_000_000
MS = 1_000_000


def message(topic, milliseconds, data=b""):
    time = BEGIN + round(milliseconds * MS)
    return RawMessage(topic, time, time, 0, data)


def test_equal_times_keep_the_order_of_the_file():
    messages = [message(topic, k, bytes([i])) for k in range(3) for i, topic in enumerate("bacd")]
    assert list(in_time_order(messages)) == messages


def test_batches_written_by_a_recorder_are_put_in_order():
    rng = random.Random(1)
    messages = [message("t", k, b"%d" % k) for k in range(5000)]
    written = sorted(messages, key=lambda m: m.log_time + rng.randrange(100 * MS))
    assert written != messages
    assert list(in_time_order(written)) == messages


def test_a_message_far_out_of_place_comes_late_but_comes():
    messages = [message("t", 1000), message("t", 1500), message("t", 0), message("t", 1600)]
    assert sorted(in_time_order(messages)) == sorted(messages)


def test_options_in_words():
    assert PlayerConfig(pace="5").speed == 5.0
    assert PlayerConfig().speed == 1.0
    assert math.isinf(PlayerConfig(pace="fast").speed)


@pytest.mark.parametrize("wrong", [{"start": -1.0}, {"pace": "warp"}, {"pace": "0"}])
def test_wrong_options_are_refused(wrong):
    with pytest.raises(ConfigError):
        PlayerConfig(**wrong)
