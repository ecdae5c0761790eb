"""hydrotwin: identify, learn, compare and export models of hydraulic actuators, and find the physics they lack.

The verbs and nouns of the package, gathered from its rooms; each is imported when first used.

>>> import hydrotwin
>>> model = hydrotwin.load("cehA")
>>> [signal.name for signal in model.flat.inputs]
['command']
"""

from __future__ import annotations

import importlib
from importlib.metadata import PackageNotFoundError, version

_WHERE = {
    "Block": "simulation",
    "Comparison": "comparison",
    "Component": "models.language",
    "Discovery": "discovery.answer.discovery",
    "Ensemble": "simulation",
    "Fit": "identification",
    "HydrotwinError": "models.language",
    "Law": "models.language",
    "Matrix": "comparison",
    "Model": "models.language",
    "Profiles": "identification",
    "Record": "records",
    "Sensitivity": "identification",
    "add_effect": "models.effects",
    "candidates": "models.effects",
    "check_fmu": "export",
    "compare": "comparison",
    "compare_schema": "report",
    "discover": "discovery.discover",
    "effects": "models.effects",
    "export_fmu": "export",
    "figures": "report",
    "from_control": "simulation.control_system",
    "identify": "identification",
    "learn": "learned",
    "load": "loading",
    "modelica_text": "models.language.modelica",
    "profile": "identification",
    "published_formula": "learned",
    "read_fmu": "export",
    "read_record": "records",
    "read_model_file": "models.language.model_file",
    "read_scenario": "comparison",
    "record_comparison": "comparison",
    "reference_experiment": "export",
    "run_matrix": "comparison",
    "sensitivity": "identification",
    "simulate": "simulation",
    "simulate_many": "simulation",
    "to_control": "simulation.control_system",
    "train_network": "learned",
    "write_gap_report": "report.gap",
    "write_matrix": "report",
    "write_model_file": "models.language.model_file",
    "write_record": "records",
    "write_report": "report",
    "write_sensitivity": "report",
}
__all__ = sorted(_WHERE)

try:
    __version__ = version("hydrotwin")
except PackageNotFoundError:  # run from a folder that was never installed
    __version__ = "0+unknown"


def __getattr__(name: str):
    if name not in _WHERE:
        raise AttributeError(f"module 'hydrotwin' has no attribute '{name}'")
    if name == "effects":
        return importlib.import_module("hydrotwin.models.effects").CATALOGUE
    return getattr(importlib.import_module(f"hydrotwin.{_WHERE[name]}"), name)


def __dir__():
    return sorted({*globals(), *__all__})
