"""Reads YAML files that users write. Pure: imports nothing of ROS."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from koop_core.config.parameter import ConfigError

LARGEST = 1 << 20
"""Bytes; a file of settings is smaller, and a parser takes long for a file that is none."""


def read_yaml(path: str | Path, loader: type[yaml.SafeLoader] = yaml.SafeLoader) -> Any:
    """Return the content of a YAML file; raise ConfigError if it is unreadable or too large."""
    return parse_yaml(read_settings(path), path, loader)


def read_settings(path: str | Path) -> str:
    """Return the text of a file of settings; raise ConfigError if it is unreadable or too large."""
    try:
        if Path(path).stat().st_size > LARGEST:
            raise ConfigError(f"{path}: is too large for a file of settings")
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeError as error:
        raise ConfigError(f"{path}: cannot be read as YAML: {error}") from None


def parse_yaml(text: str, path: str | Path, loader: type[yaml.SafeLoader]) -> Any:
    """Return the content of a YAML text; raise ConfigError, which names its file, if it is none."""
    try:
        return yaml.load(text, loader)
    except (ValueError, yaml.YAMLError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read as YAML: {error}") from None


class Lined(dict[Any, Any]):
    """A mapping of a file, which knows the line of each key."""

    lines: dict[str, int]


class LinedLoader(yaml.SafeLoader):
    """Makes every mapping a :class:`Lined`; a key may stand there once; 1e-3 is a number."""

    def construct_lined(self, node: yaml.MappingNode) -> Lined:
        """Return the mapping of a node."""
        lined = Lined()
        lined.lines = {}
        for key, value in node.value:
            name, line = self.construct_object(key, deep=True), key.start_mark.line + 1
            if name in lined:
                text = f"'{name}' stands in line {lined.lines[name]} already"
                raise yaml.constructor.ConstructorError(None, None, text, key.start_mark)
            lined[name] = self.construct_object(value, deep=True)
            lined.lines[str(name)] = line
        return lined


LinedLoader.add_constructor("tag:yaml.org,2002:map", LinedLoader.construct_lined)
LinedLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+$"), list("-+0123456789")
)
