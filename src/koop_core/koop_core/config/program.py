"""Programs of the user that a parameter names."""

from __future__ import annotations

import shlex
import shutil

from koop_core.config.parameter import ConfigError


def split_command(name: str, text: str) -> tuple[str, ...]:
    """Return a program and its arguments; none for an empty text.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If the text of this name cannot be read, or the program does not exist.

    Examples
    --------
    >>> split_command("on_alarm", "sh -c 'echo $KOOP_ALARM_REASON'")
    ('sh', '-c', 'echo $KOOP_ALARM_REASON')
    """
    try:
        words = tuple(shlex.split(text))
    except ValueError as error:
        raise ConfigError(f"{name} = {text!r}: {error}") from None
    if words and shutil.which(words[0]) is None:
        raise ConfigError(f"{name} = {text!r}: no program {words[0]!r} found")
    return words
