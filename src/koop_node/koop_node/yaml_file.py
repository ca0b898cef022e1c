"""Reads YAML files that users write. Pure: imports nothing of ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from koop_node.config import ConfigError

LARGEST = 1 << 20
"""Bytes; a file of settings is smaller, and a parser takes long for a file that is none."""


def read_yaml(path: str | Path, loader: type[yaml.SafeLoader] = yaml.SafeLoader) -> Any:
    """Return the content of a YAML file.

    Raises
    ------
    koop_node.config.ConfigError
        If it cannot be read, is too large or is not YAML.
    """
    try:
        if Path(path).stat().st_size > LARGEST:
            raise ConfigError(f"{path}: is too large for a file of settings")
        return yaml.load(Path(path).read_text(encoding="utf-8"), loader)
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, yaml.YAMLError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read as YAML: {error}") from None
