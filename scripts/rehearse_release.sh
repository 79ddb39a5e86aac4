#!/usr/bin/env bash
# `make release` on an empty machine: Debian's packages of README.md and nothing else, in a folder of
# its own, with this commit. What pip is told of an index and of certificates here, it is told there.
#
# usage: scripts/rehearse_release.sh [SUITE [FOLDER]]    bookworm; needs root and mmdebstrap
#   FOLDER stays and is taken again the next time; without one a folder for the moment is used.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
suite=${1:-bookworm} machine=${2:-}
for program in mmdebstrap unshare chroot; do
    command -v "$program" >/dev/null || {
        echo "rehearsal: there is no $program: apt install mmdebstrap util-linux coreutils" >&2
        exit 1
    }
done
[[ $(id -u) == 0 ]] || {
    echo "rehearsal: only root may enter another machine's folder (chroot)" >&2
    exit 1
}
if [[ -z $machine ]]; then
    machine=$(mktemp -d)
    trap 'rm -rf --one-file-system "$machine"' EXIT
fi
if [[ ! -e $machine/bin/sh ]]; then
    mmdebstrap --quiet --variant=minbase --include=ca-certificates,g++,git,make,python3-dev,python3-venv \
        "$suite" "$machine"
fi
echo "rehearsal: $suite after $SECONDS s"
rm -rf "$machine/rotcal_ros"
git clone --quiet --no-hardlinks . "$machine/rotcal_ros"
for settings in /etc/pip.conf /etc/xdg/pip /etc/resolv.conf /etc/ssl/certs/ca-certificates.crt; do
    [[ ! -e $settings ]] || cp -rL --parents "$settings" "$machine"
done
mapfile -t settings_of_pip < <(env | grep '^PIP_' || true)
unshare --mount --pid --fork --mount-proc="$machine/proc" chroot "$machine" \
    env -i HOME=/root LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin "${settings_of_pip[@]}" \
    make -C /rotcal_ros release RELEASE_ARGS=--rehearse
mkdir -p out
rm -rf out/rehearsal
cp -r "$machine/rotcal_ros/out/release" out/rehearsal
echo "rehearsal: done after $SECONDS s: out/rehearsal"
