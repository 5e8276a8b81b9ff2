"""Repair of real tracks: entries that were not seen are completed, entries that are wrong are found and replaced."""

from nrsfm.repair.options import Repaired, RepairOptions
from nrsfm.repair.resection import Resection, resect, resect_by_cells, trusted_points
from nrsfm.repair.stage import repair

__all__ = ["RepairOptions", "Repaired", "Resection", "repair", "resect", "resect_by_cells", "trusted_points"]
