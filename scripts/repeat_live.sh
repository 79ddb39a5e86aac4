#!/usr/bin/env bash
# The live tests again and again beside busy processes, to find what fails now and then. Every odd
# round runs in peace, every even one beside BUSY processes that only want the processor.
# Ends with a summary of what failed how often; exit code 1 if anything did.
#
# usage: scripts/repeat_live.sh ROUNDS [BUSY] [arguments of pytest]    logs in out/repeat_live
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

rounds=${1:?usage: scripts/repeat_live.sh ROUNDS [BUSY] [arguments of pytest]}
busy=${2:-4}
shift "$(($# < 2 ? $# : 2))"
logs=out/repeat_live
mkdir -p "$logs"
rm -f "$logs"/*.log
others=()

# End the busy processes that this script has started.
quiet() {
    ((${#others[@]} == 0)) || kill "${others[@]}" 2>/dev/null
    others=()
}
trap quiet EXIT
trap 'exit 130' INT TERM

for ((round = 1; round <= rounds; round++)); do
    if ((round % 2 == 0)); then
        for ((i = 0; i < busy; i++)); do
            (while :; do :; done) &
            others+=("$!")
        done
    fi
    log=$logs/$round.log
    start=$SECONDS
    OMP_NUM_THREADS=1 "${VENV:-.venv}/bin/python" -m pytest --live only "$@" >"$log" 2>&1
    code=$?
    echo "round $round beside ${#others[@]}: code $code, $((SECONDS - start)) s," \
        "$(tail -n 1 "$log" | tr -d '=')"
    quiet
    # Interrupted, wrong usage or nothing selected: the next round would end alike.
    ((code < 2)) || exit "$code"
done

failures=$(grep -hE '^(FAILED|ERROR) ' "$logs"/*.log | cut -d ' ' -f 2 | sort | uniq -c | sort -rn)
if [[ -n $failures ]]; then
    echo "failed in $rounds rounds:"
    echo "$failures"
    exit 1
fi
echo "no failure in $rounds rounds"
