#!/usr/bin/env bash
# What the packages beside the core need, and what the core needs of them: nothing. As if none were
# installed, all tests of the core can be imported, and those that ask for verbs, settings, plug-ins,
# languages and names of the interface pass; as if one were the only one, all of it and of its tests
# can be imported. `make test PACKAGE=... ALONE=1` runs all tests of one, rotcal_ros being the core.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
python=${VENV:-.venv}/bin/python
run=("$python" -m pytest -q --quick --live never -p no:cacheprovider)
export OMP_NUM_THREADS=1

"$python" scripts/alone.py -- "${run[@]}" --collect-only test >/dev/null
"$python" scripts/alone.py -- "${run[@]}" test/cli/test_cli_main.py test/cli/test_settings*.py \
    test/api/test_names.py test/foundation/test_plugins.py test/foundation/test_language.py
for package in packages/rotcal_*; do
    name=${package##*/}
    "$python" scripts/alone.py "$name" -- "$python" - "$name" <<'PYTHON'
import pkgutil, sys
from importlib import import_module
for module in pkgutil.walk_packages(import_module(sys.argv[1]).__path__, f"{sys.argv[1]}."):
    if "migrations" not in module.name:  # scripts of alembic
        import_module(module.name)
PYTHON
    "$python" scripts/alone.py "$name" -- "${run[@]}" --collect-only "$package/test" >/dev/null
    echo "$name: can be used without the others"
done
