#!/usr/bin/env bash
# All tests: those without live nodes side by side on all cores, each file in one worker, so that what
# its tests share is made once. Then the live ones, one at a time, because whole cells beat, stream
# and record in real time.
#
# usage: scripts/test.sh [arguments of pytest]
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

NONE_SELECTED=5
result=$NONE_SELECTED

run() {
    "${VENV:-.venv}/bin/python" -m pytest "$@"
    local code=$?
    # Of the two halves one may be empty; the first failure is what the whole says.
    if [[ $result == 0 || $result == "$NONE_SELECTED" ]] && [[ $code != "$NONE_SELECTED" ]]; then
        result=$code
    fi
}

export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
run --live never -n auto --dist loadfile --no-loadscope-reorder "$@"
run --live only "$@"
exit "$result"
