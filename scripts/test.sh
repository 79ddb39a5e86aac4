#!/usr/bin/env bash
# The tests: first those without live nodes, then the live ones; side by side on all cores, each file
# in one worker, so that what its tests share is made once. ROTCAL_LIVE_WORKERS=1 runs one cell at a
# time; live tests wait much, so it is two cells for each core. At the end it says what could not be
# tried on this machine, and what to install for it.
#
# usage: scripts/test.sh [--quick] [arguments of pytest]    --quick: without those marked slow
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

NONE_SELECTED=5
result=$NONE_SELECTED
ROTCAL_NOT_TRIED=$(mktemp)
export ROTCAL_NOT_TRIED
trap 'rm -f "$ROTCAL_NOT_TRIED"' EXIT

run() {
    "${VENV:-.venv}/bin/python" -m pytest "$@"
    local code=$?
    # Of the two halves one may be empty; the first failure is what the whole says.
    if [[ $result == 0 || $result == "$NONE_SELECTED" ]] && [[ $code != "$NONE_SELECTED" ]]; then
        result=$code
    fi
}

cells=${ROTCAL_LIVE_WORKERS:-$((2 * $(nproc)))} # before the next line, which nproc heeds
export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
side_by_side=(--dist loadfile --no-loadscope-reorder)
run --live never -n auto "${side_by_side[@]}" "$@"
run --live only -n "$cells" "${side_by_side[@]}" "$@"
if [[ -s $ROTCAL_NOT_TRIED ]]; then
    echo "Not tried here (tests, reason):"
    sort "$ROTCAL_NOT_TRIED" | uniq -c
fi
exit "$result"
