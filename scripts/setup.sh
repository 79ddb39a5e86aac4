#!/usr/bin/env bash
# Makes .venv with rotcal_ros, the packages beside it and all that they need: Python packages, ROS 2
# wheels, rotcal_msgs. That is ROS 2 Jazzy; the environment of any other distribution is named after
# it: .venv-kilted.
#
# Three parts, each with a stamp that holds the hash of what it was made from; the second run
# finds three good stamps and is done. A part removes its stamp before it starts, so that an
# interrupted set-up is noticed and repeated.
#
# usage: scripts/setup.sh [jazzy|kilted|check]    check: only see whether this machine can do it
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

PYTHON=${PYTHON:-python3}
DISTRO=${1:-jazzy}
[[ $DISTRO != check ]] || DISTRO=jazzy
SUFFIX=-$DISTRO
[[ $DISTRO != jazzy ]] || SUFFIX=
VENV=$PWD/.venv$SUFFIX
BUILD=$PWD/build/setup$SUFFIX
LOG=$BUILD/setup.log
PACKAGES=$(cd packages && echo rotcal_*)
EXTRAS=${ROTCAL_EXTRAS:-ros,parquet,protobuf,notebook,page,docs,test,packages}
EXTRAS=${EXTRAS/packages/${PACKAGES// /,}},build,build-$DISTRO
LOCK=locks/$DISTRO.txt
# Settings of a sourced ROS installation or of another environment would leak into this one.
unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME PYTHONPATH
unset VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE

say() { echo "set-up: $*" >&2; }

fail() {
    say "$*"
    exit 1
}

# Run a command with its output in the log; when it fails, show the end of the log.
quietly() {
    echo "+ $*" >>"$LOG"
    "$@" >>"$LOG" 2>&1 || {
        tail -n 25 "$LOG" | cut -c 1-300 >&2
        fail "this failed; all of the log is in $LOG"
    }
}

python_says() { "$PYTHON" -c "import sys, sysconfig; $1"; }

check_machine() {
    [[ -e $LOCK ]] || fail "ROS 2 '$DISTRO' is not supported; there are:" locks/*.txt
    [[ $(uname -sm) == "Linux x86_64" ]] ||
        fail "ROS 2 wheels exist for x86-64 Linux only, this is $(uname -sm)"
    command -v "$PYTHON" >/dev/null ||
        fail "no '$PYTHON'; install Python 3.10 or newer, or name one: make PYTHON=python3.12 ..."
    python_says 'sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 14))' ||
        fail "Python 3.10 to 3.14 is needed, '$PYTHON' is $(python_says 'print(sys.version.split()[0])');" \
            "name another: make PYTHON=python3.12 ..."
    python_says 'import ensurepip, venv' 2>/dev/null ||
        fail "Python's venv module is missing; on Debian and Ubuntu: apt install python3-venv"
    [[ -e $(python_says 'print(sysconfig.get_path("include"))')/Python.h ]] ||
        fail "Python's headers (Python.h) are missing; on Debian and Ubuntu: apt install python3-dev"
    command -v "${CC:-cc}" >/dev/null && command -v "${CXX:-c++}" >/dev/null ||
        fail "a C and C++ compiler is missing; on Debian and Ubuntu: apt install g++"
}

# A stamp .venv/.<name> holds the hash of what the part was made from.
is_made() { [[ -e $VENV/.$1 && $(<"$VENV/.$1") == "$2" ]]; }
stamp() { echo "$2" >"$VENV/.$1"; }
hash_of() { sha256sum | cut -c 1-64; }

make_environment() {
    say "1/3 new environment ${VENV##*/} with ROS 2 ${DISTRO^}, Python $(python_says 'print(sys.version.split()[0])')"
    rm -rf "$VENV"
    quietly "$PYTHON" -m venv "$VENV"
    touch "$VENV/COLCON_IGNORE"
}

install_packages() {
    say "2/3 Python packages and ROS 2 wheels (1 GB on disk, a minute or two)"
    local pip=("$VENV/bin/python" -m pip --disable-pip-version-check)
    local hashed=(--require-hashes --no-deps --no-build-isolation -r) settings
    locked tools >"$BUILD/tools.txt"
    locked core "$EXTRAS" >"$BUILD/packages.txt"
    quietly "${pip[@]}" install "${hashed[@]}" "$BUILD/tools.txt"
    hashed+=("$BUILD/packages.txt")
    # uv takes seconds where pip takes a minute, but knows nothing of a mirror that pip is told of.
    settings=$("${pip[@]}" config list)
    if [[ $settings =~ [.](no-index|index-url)= ]] || ! by_uv "${hashed[@]}"; then
        quietly "${pip[@]}" install "${hashed[@]}"
    fi
    install_ours
    enter_into_ament_index
}

# The packages of some extras, with versions and hashes, from the lock of the distribution.
locked() {
    local parts="$*"
    awk -v parts=" ${parts//,/ } " '
        /^# for: / { ours = 0; for (n = 3; n <= NF; n++) ours = ours || index(parts, " " $n " ") }
        /^#/ { next }
        ours' "$LOCK"
}

by_uv() {
    echo "+ uv pip install $*" >>"$LOG"
    env ${PIP_CERT:+SSL_CERT_FILE="$PIP_CERT"} \
        "$VENV/bin/uv" pip install --quiet --python "$VENV/bin/python" "$@" >>"$LOG" 2>&1
}

# The core and the packages beside it, as they lie here; a package whose folder is gone goes, too.
install_ours() {
    local package ours=(--no-deps --no-build-isolation -e .)
    for package in $("${pip[@]}" list --format freeze | sed -n 's/^\(rotcal_[a-z_]*\)==.*/\1/p'); do
        [[ " rotcal_ros rotcal_msgs $PACKAGES " == *" $package "* ]] ||
            quietly "${pip[@]}" uninstall -y "$package"
    done
    for package in $PACKAGES; do
        ours+=(-e "packages/$package")
    done
    by_uv "${ours[@]}" || quietly "${pip[@]}" install --use-pep517 "${ours[@]}"
    rm -rf ./*.egg-info packages/*/*.egg-info # found before what is installed, and soon out of date
}

# What `ros2 run` and `ros2 launch` look for, should there be any: pip leaves it out. Links of files,
# because ROS does not look into linked folders.
enter_into_ament_index() {
    local share=$VENV/share index=$VENV/share/ament_index/resource_index/packages package
    mkdir -p "$index"
    find "$VENV/lib" "$share" "$index" -maxdepth 1 -name 'rotcal_*' ! -name rotcal_msgs -exec rm -rf {} +
    for package in . $(printf 'packages/%s ' $PACKAGES); do
        cp "$package"/resource/* "$index"
    done
    mkdir "$share/rotcal_ros" $(printf "$share/%s " $PACKAGES)
    cp -rs "$PWD/package.xml" "$PWD/config" "$PWD/launch" "$share/rotcal_ros"
    for package in $PACKAGES; do
        cp -s "$PWD/packages/$package/package.xml" "$share/$package"
    done
    quietly "$VENV/bin/python" - "$VENV" <<'END'
import sys
from importlib.metadata import entry_points
from pathlib import Path

for script in entry_points(group="console_scripts"):
    if script.dist.name.startswith("rotcal_"):
        place = Path(sys.argv[1], "lib", script.dist.name)
        place.mkdir(exist_ok=True)
        (place / script.name).symlink_to(f"../../bin/{script.name}")
END
    # An activated environment is a prefix of ROS; what was sourced before stays behind it.
    grep -q AMENT_PREFIX_PATH "$VENV/bin/activate" ||
        echo 'export AMENT_PREFIX_PATH="$VIRTUAL_ENV${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"' \
            >>"$VENV/bin/activate"
}

# The real rosidl chain, into the environment; files of an older build are taken away first.
build_messages() {
    say "3/3 building rotcal_msgs"
    if [[ -e $VENV/.installed_messages ]]; then
        xargs -d '\n' rm -f <"$VENV/.installed_messages"
    fi
    rm -rf "$BUILD/rotcal_msgs"
    local path=$VENV/bin:$PATH
    quietly env PATH="$path" AMENT_PREFIX_PATH="$VENV" cmake -S msg_defs -B "$BUILD/rotcal_msgs" \
        -G Ninja -DCMAKE_PREFIX_PATH="$VENV" -DCMAKE_INSTALL_PREFIX="$VENV" \
        -DPython3_EXECUTABLE="$VENV/bin/python" -DBUILD_TESTING=OFF -DCMAKE_BUILD_TYPE=Release \
        -DWITHOUT_CPP=ON
    quietly env PATH="$path" AMENT_PREFIX_PATH="$VENV" ninja -C "$BUILD/rotcal_msgs" install
    cp "$BUILD/rotcal_msgs/install_manifest.txt" "$VENV/.installed_messages"
    quietly "$VENV/bin/python" -c 'import rotcal_msgs.msg, rotcal_msgs.srv, rotcal_msgs.action'
}

check_machine
[[ ${1:-} != check ]] || exit 0

mkdir -p "$BUILD"
touch build/COLCON_IGNORE
exec 9>"$BUILD/lock"
flock 9 # two terminals, one set-up
# An environment can neither be moved nor serve another Python or distribution.
environment=$({ python_says 'print(sys.version, sys.base_prefix)' && echo "$PWD $DISTRO"; } | hash_of)
packages=$({
    echo "$environment" && cat "$LOCK" setup.* packages/*/setup.* scripts/setup.sh rotcal_ros/{__init__,foundation/node_names}.py
    find config launch -type f | sort
} | hash_of)
messages=$({
    echo "$environment" && cat "$LOCK"
    find msg_defs -type f -print0 | sort -z | xargs -0 sha256sum
} | hash_of)
if is_made packages "$packages" && is_made messages "$messages"; then
    exit 0
fi
: >"$LOG"
trap 'say "interrupted; run it again"; exit 130' INT
if ! is_made packages "$packages"; then
    # Without a packages stamp the last pip run has not ended well: start afresh.
    if ! is_made environment "$environment" || [[ ! -e $VENV/.packages ]]; then
        [[ ! -e $VENV ]] ||
            say "${VENV##*/} is of another ROS 2, Python or folder, or was not finished: it is made anew"
        make_environment
        stamp environment "$environment"
    fi
    rm -f "$VENV/.packages"
    install_packages
    stamp packages "$packages"
fi
if ! is_made messages "$messages"; then
    rm -f "$VENV/.messages"
    build_messages
    stamp messages "$messages"
fi
say "done in $SECONDS s"
