#!/usr/bin/env bash
# The way of a ROS 2 user: a workspace as docs/install.md makes it, `colcon build` without a word
# more and with keys that rosdep knows, a node out of the install folder as `ros2 run rotcal_ros planner` starts it, and Ctrl-C.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD
work=$root/build/colcon
if [[ $root == *" "* ]]; then
    echo "check_colcon: the scripts that colcon generates break at the blank in '$root'" >&2
    exit 1
fi
scripts/setup.sh

# A ROS installation would be sourced here; the wheels in .venv take its place.
export PATH=$root/.venv/bin:$PATH AMENT_PREFIX_PATH=$root/.venv
unset CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
rm -rf "$work"
mkdir -p "$work/src"
cd "$work"
ln -s "$root" src/rotcal_ros
ln -s rotcal_ros/msg_defs rotcal_ros/packages src
python "$root/scripts/check_keys.py" src
colcon build || {
    tail -n 30 log/latest_build/*/stderr.log >&2
    exit 1
}
set +u # the generated scripts read variables that are not set
source install/setup.bash
set -u
for folder in config launch; do
    [[ ! -d $root/$folder ]] || diff -r "$root/$folder" "install/rotcal_ros/share/rotcal_ros/$folder"
done
program=$(type -P rotcal)
[[ $program == "$PWD/install/"* ]] || {
    echo "check_colcon: rotcal on the path is '$program', not that of the install folder" >&2
    exit 1
}
rotcal --version
for package in "$root"/packages/*/; do
    package=$(basename "$package")
    [[ $(python -c "import $package as p; print(p.__file__)") == "$PWD/install/$package/"* ]]
done
python "$root/scripts/check_node.py" "$work/install" planner
