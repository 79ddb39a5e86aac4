#!/usr/bin/env bash
# What the packages beside the core need, and what the core needs of them: nothing. As if none were
# installed, the quick tests of the command line and of what the whole tree says of itself pass; as
# if one were the only one, all of it and of its tests can be imported. `make test PACKAGE=... ALONE=1`
# runs all tests of one.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
python=${VENV:-.venv}/bin/python
run=("$python" -m pytest -q --quick --live never -p no:cacheprovider)
export OMP_NUM_THREADS=1

"$python" scripts/alone.py -- "${run[@]}" -n "$(nproc)" \
    test/cli test/sessions test/foundation test/api test/nodes/adapters test/nodes/check
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
