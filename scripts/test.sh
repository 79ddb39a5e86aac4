#!/usr/bin/env bash
# All tests: those without live nodes side by side on all cores, then the live ones, two at a time:
# whole cells beat, stream and record in real time, and leave half of a small machine idle. A file
# stays with one worker, so that what its tests share is made once.
#
# LIVE_AT_ONCE=1 runs live tests one at a time.
# usage: scripts/test.sh [arguments of pytest]
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

NONE_SELECTED=5
result=$NONE_SELECTED

run() {
    .venv/bin/python -m pytest "$@"
    local code=$?
    # Of the two halves one may be empty; the first failure is what the whole says.
    if [[ $result == 0 || $result == "$NONE_SELECTED" ]] && [[ $code != "$NONE_SELECTED" ]]; then
        result=$code
    fi
}

export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
by_file=(--dist loadfile --no-loadscope-reorder)
run --live never -n auto "${by_file[@]}" "$@"
run --live only -n "${LIVE_AT_ONCE:-2}" "${by_file[@]}" "$@"
exit "$result"
