#!/usr/bin/env bash
# Runs launch/experiment.launch and ends with its success: `scripts/demo.sh [launch arguments]`, after setup/setup.sh.
set -o pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
source "$root/.ws/env.bash"
python "$root/scripts/check_ports.py" "$@" || exit 1

export ROS_MASTER_URI=http://localhost:${ROS_MASTER_PORT:-11311}
before=$(readlink "$root/results/latest" 2>/dev/null || true)
# The experiment ends the launch by ending itself; what roslaunch has to say about that is not news.
roslaunch -p "${ROS_MASTER_PORT:-11311}" --no-summary construction_twin experiment.launch results_dir:="$root/results" "$@" 2>&1 |
  awk '/REQUIRED process \[.*\/experiment-/ { quiet = 1 }
       !quiet && !/process\[|setting \/run_id|started core service|auto-starting|started roslaunch|ROS_MASTER_URI=/ \
              && !/logging to|Checking log|Press Ctrl-C|Done checking|\]2;|^ *$/ { print; fflush() }'
after=$(readlink "$root/results/latest" 2>/dev/null || true)
if [ -z "$after" ] || [ "$after" = "$before" ] || [ ! -f "$root/results/latest/summary.json" ]; then
  echo "demo: the experiment did not finish; the sentences above say why. Logs of every node: ${ROS_LOG_DIR:-$HOME/.ros/log}/latest" >&2
  exit 1
fi
