#!/usr/bin/env bash
# All tests: those without live nodes side by side on all cores, each file in one worker, so that what
# its tests share is made once. Then the live ones: cells one at a time, because they beat, stream and
# record in real time, and beside them what needs little processor time.
#
# usage: scripts/test.sh [arguments of pytest]
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

NONE_SELECTED=5
result=$NONE_SELECTED

# Of the parts some may be empty; the first failure is what the whole says.
take() {
    if [[ $result == 0 || $result == "$NONE_SELECTED" ]] && [[ $1 != "$NONE_SELECTED" ]]; then
        result=$1
    fi
}

export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
.venv/bin/python -m pytest --live never -n auto --dist loadfile --no-loadscope-reorder "$@"
take $?

shown=$(mktemp)
trap 'rm -f "$shown"' EXIT
.venv/bin/python -m pytest --live beside "$@" >"$shown" 2>&1 &
beside=$!
.venv/bin/python -m pytest --live cells "$@"
take $?
wait "$beside"
take $?
cat "$shown"
exit "$result"
