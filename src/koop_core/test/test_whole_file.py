"""A file that is whole at any time: the new content or the old one."""

import pytest

from koop_core import whole_file
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError


def test_a_file_is_whole_or_the_old_one(tmp_path):
    path = tmp_path / "a.json"
    whole_file.write_json(path, {"a": 1})
    (tmp_path / "a.json.new").symlink_to("/dev/full")
    with pytest.raises(LiveError, match=r"a\.json: No space left on device: make room"):
        whole_file.write_json(path, {"a": 2})
    assert [item.name for item in tmp_path.iterdir()] == ["a.json"]
    with pytest.raises(UnicodeEncodeError):
        whole_file.write_text(path, "new \ud800")
    assert [item.name for item in tmp_path.iterdir()] == ["a.json"]
    assert whole_file.read_json(path) == {"a": 1}
    with pytest.raises(LiveError, match="No such file"):
        whole_file.write_text(tmp_path / "no" / "b", "text")
    assert whole_file.read_json(tmp_path / "none") == {}
    path.write_text("{")
    with pytest.raises(ConfigError, match="cannot be read"):
        whole_file.read_json(path)
