"""The methods of the comparison, one file each, found by name."""

from __future__ import annotations

import importlib

from nrsfm.errors import OptionError, suggest
from nrsfm.methods.base import Method

_METHODS = {
    "auto": ("nrsfm.methods.auto", "Auto"),
    "bmm": ("nrsfm.methods.bmm", "Bmm"),
    "grassmann": ("nrsfm.methods.grassmann", "Grassmann"),
    "geometry-aware": ("nrsfm.methods.geometry_aware", "GeometryAware"),
    "pta": ("nrsfm.methods.pta", "Pta"),
    "csf1": ("nrsfm.methods.csf1", "Csf1"),
    "csf2": ("nrsfm.methods.csf2", "Csf2"),
    "ksta": ("nrsfm.methods.ksta", "Ksta"),
    "mp": ("nrsfm.methods.mp", "Mp"),
    "dv": ("nrsfm.methods.dv", "Dv"),
    "ds": ("nrsfm.methods.ds", "Ds"),
    "smsr": ("nrsfm.methods.smsr", "Smsr"),
    "rbmm": ("nrsfm.methods.rbmm", "Rbmm"),
    "organic": ("nrsfm.methods.organic", "Organic"),
    "em-pnd": ("nrsfm.methods.em_pnd", "EmPnd"),
}


def method_names() -> list[str]:
    """Names that ``reconstruct(..., method=...)`` takes."""
    return list(_METHODS)


def get_method(name: str) -> Method:
    """The method of that name; raises ``OptionError`` with the nearest names for an unknown one."""
    if name not in _METHODS:
        raise OptionError(
            f"method must be one of {', '.join(_METHODS)}, received {name!r}{suggest(str(name), _METHODS)}"
        )
    module, attribute = _METHODS[name]
    method: Method = getattr(importlib.import_module(module), attribute)()
    return method
