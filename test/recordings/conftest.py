"""The sample bags of ``test/bags``, for the package above it."""

import importlib.util
import sys
from pathlib import Path

BAGS = Path(__file__).parents[1] / "bags"
sys.path.insert(0, str(BAGS))
_spec = importlib.util.spec_from_file_location("bag_fixtures", BAGS / "conftest.py")
assert _spec is not None
assert _spec.loader is not None
_fixtures = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_fixtures)
simulated_run, run_bag = _fixtures.simulated_run, _fixtures.run_bag
