"""The simulation of research/policy_figures.py, for small versions of its figures."""

import importlib.util
import sys
from pathlib import Path

PATH = Path(__file__).parents[4] / "research" / "policy_figures.py"
spec = importlib.util.spec_from_file_location("policy_figures", PATH)
figures = importlib.util.module_from_spec(spec)
sys.modules["policy_figures"] = figures
spec.loader.exec_module(figures)
