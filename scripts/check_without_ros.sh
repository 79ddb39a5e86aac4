#!/usr/bin/env bash
# The core alone: `pip install .` into a fresh environment that has no ROS.
#
# usage: scripts/check_without_ros.sh [CALIBRATION]
#   CALIBRATION, a folder that `make demo` has written: its bag is solved here as well, and the
#   result must be equal to the live one to the last bit.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
work=$PWD/build/without-ros
unset AMENT_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
scripts/setup.sh check

rm -rf "$work"
mkdir -p "$work/source"
# From a copy: pip leaves its traces in the folder that it builds.
git ls-files -z --cached --others --exclude-standard |
    tar --create --null --files-from - --ignore-failed-read | tar --extract -C "$work/source"
"${PYTHON:-python3}" -m venv "$work/venv"
python=$work/venv/bin/python
"$python" -m pip --disable-pip-version-check --quiet install -c constraints.txt "$work/source" \
    2>"$work/pip.log" || {
    tail "$work/pip.log" >&2
    exit 1
}

cd "$work" # away from the checkout, so that its modules cannot help
"$python" - <<'PYTHON'
import importlib.util
for name in ("rclpy", "rotcal_msgs", "std_msgs"):
    assert importlib.util.find_spec(name) is None, f"{name} is here: this proves nothing"
PYTHON
venv/bin/rotcal --version
venv/bin/rotcal --help >/dev/null
[[ -n ${1:-} ]] || exit 0

cd - >/dev/null
calibration=$(realpath "$1")
cd "$work"
# Exit code 1 is a verdict that is not ok, which the live result has as well then.
"$work/venv/bin/rotcal" solve "$calibration/bag" --json >solved.json || (($? == 1))
"$python" - "$calibration/result.json" solved.json <<'PYTHON'
import json
import sys
live, solved = (json.load(open(path)) for path in sys.argv[1:])
# JSON numbers are written so that they read back as the same bits.
different = sorted(key for key in live.keys() | solved.keys() if live.get(key) != solved.get(key))
sys.exit(f"live and offline results differ in: {', '.join(different)}" if different else 0)
PYTHON
echo "solved without ROS: equal to the live result to the last bit"
