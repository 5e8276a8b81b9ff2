"""Command-line options: an argparse that explains itself in one line, and flags from options dataclasses."""

from __future__ import annotations

import argparse
import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np

from nrsfm.cli.intrinsics import METAVAR, read_intrinsics
from nrsfm.errors import OptionError, suggest
from nrsfm.options import field_types

_DEST = "option:"  # keeps the fields of options dataclasses apart from the verb's own arguments
_NUMBER = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.IGNORECASE)


class Parser(argparse.ArgumentParser):
    """``argparse`` that raises ``OptionError`` and names the nearest known options."""

    def __init__(self, **settings: Any) -> None:
        settings.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(allow_abbrev=False, **settings)
        self.add_argument("--debug", action="store_true", help="show the whole traceback of an error")

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage and exiting."""
        raise OptionError(f"{message}; see {self.prog} --help")

    def flags(self) -> list[str]:
        """Return every long option of this parser."""
        # argparse offers no public list, and this attribute has not changed since Python 2.7.
        return [flag for flag in self._option_string_actions if flag.startswith("--")]

    def parse_strictly(
        self, words: Sequence[str], elsewhere: Callable[[str], str | None] = lambda flag: None
    ) -> argparse.Namespace:
        """Parse everything; unknown options are found first, whatever else is missing.

        ``elsewhere`` may explain a flag that exists, but not here.
        """
        words = _join_negative_numbers(words)
        known = self.flags()
        for word in words:
            if word == "--":
                break
            flag = word.split("=", 1)[0]
            if word.startswith("--") and flag not in known:
                explained = elsewhere(flag)
                raise OptionError(
                    f"unknown option '{flag}'" + (f"; {explained}" if explained else suggest(flag, known))
                )
        namespace, rest = self.parse_known_args(words)
        if rest:
            unknown = next((word for word in rest if word.startswith("-")), None)
            what = f"unknown option '{unknown}'" if unknown else f"unexpected argument '{rest[0]}'"
            raise OptionError(f"{what}; see {self.prog} --help")
        return namespace


def _join_negative_numbers(words: Sequence[str]) -> list[str]:
    """Write ``--flag -1e-3`` as ``--flag=-1e-3``: argparse takes such a number for an option."""
    joined: list[str] = []
    for word in words:
        if _NUMBER.match(word) and joined and joined[-1].startswith("--") and "=" not in joined[-1]:
            joined[-1] += "=" + word
        else:
            joined.append(word)
    return joined


def flag_of(name: str) -> str:
    """Return the command-line spelling of an options field."""
    return "--" + name.replace("_", "-")


def add_options(parser: Parser, title: str, cls: type, prefix: str = "") -> None:
    """Add one flag for each field of an options dataclass, in a group of that title; ``prefix`` goes before names."""
    group = parser.add_argument_group(title)
    kinds = field_types(cls)
    for field in dataclasses.fields(cls):
        kind, optional = kinds[field.name]
        settings: dict[str, Any] = {
            "dest": _DEST + prefix + field.name,
            "default": argparse.SUPPRESS,
            "help": _help(field, optional).replace("%", "%%"),
        }
        if kind is bool:
            settings["action"] = argparse.BooleanOptionalAction
        else:
            settings["type"] = _array_reader(field.name) if kind is np.ndarray else _converter(kind, optional)
            choices = field.metadata.get("choices")
            settings["metavar"] = "{" + ",".join(choices) + "}" if choices else _METAVARS.get(kind, "WORD")
        if field.name in _OWN_READERS:
            settings["type"], settings["metavar"] = _OWN_READERS[field.name]
        group.add_argument(flag_of(prefix + field.name), **settings)


def given_options(namespace: argparse.Namespace, prefix: str = "") -> dict[str, Any]:
    """Return the fields that were given on the command line, as keyword arguments; those with ``prefix`` alone."""
    start = _DEST + prefix
    return {key[len(start) :]: value for key, value in vars(namespace).items() if key.startswith(start)}


_METAVARS = {int: "N", float: "X", np.ndarray: "FILE"}
# Options that can be typed in a form of their own: how they are read, and what the help calls it.
_OWN_READERS: dict[str, tuple[Callable[[str], Any], str]] = {"intrinsics": (read_intrinsics, METAVAR)}


def _help(field: dataclasses.Field[Any], optional: bool) -> str:
    rule = field.metadata
    default = field.default
    facts = []
    if rule.get("symbol"):
        facts.append(f"symbol {rule['symbol']}")
    facts.append(f"default: {_word(default)}")
    if default is not None and optional:
        facts.append("auto: chosen from the data")
    return f"{' '.join(rule.get('doc', '').split())} [{'; '.join(facts)}]"


def _word(value: Any) -> str:
    """The value as it would be typed."""
    if value is None:
        return "auto"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _array_reader(name: str) -> Callable[[str], np.ndarray | None]:
    """Reads the array of that name from a file, or the only one that the file holds."""

    def read(text: str) -> np.ndarray | None:
        if text == "auto":
            return None
        from nrsfm.errors import FileError
        from nrsfm.files.container import listing, open_arrays

        try:
            entries = open_arrays(text)
            if name not in entries and len(entries) != 1:
                raise FileError(f"'{text}' must hold an array '{name}', or one array only; it holds {listing(entries)}")
            return (entries[name] if name in entries else next(iter(entries.values()))).read()
        except FileError as error:
            # argparse would replace the text of any other error.
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


def _converter(kind: type, optional: bool) -> Callable[[str], Any]:
    def convert(text: str) -> Any:
        if optional and text == "auto":
            return None
        try:
            return kind(text)
        except ValueError:
            what = "a whole number" if kind is int else "a number"
            also = " or auto" if optional else ""
            raise argparse.ArgumentTypeError(f"{what}{also} is needed, received {text!r}") from None

    return convert
