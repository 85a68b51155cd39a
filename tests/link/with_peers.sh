#!/bin/sh
# Runs a Python test with the interpreter that has the peers (scripts/setup --peers), else with the system's; exit code
# 77 means "skipped: a peer is missing", and with CI=true a missing peer is a failure.
# with_peers.sh [--bus] MODULES SCRIPT ARGUMENTS...   MODULES: comma-separated; --bus: in a network namespace of its own
# with a multicast route, so that no test hears another.
here=$(dirname "$0")
if [ "$1" = "--bus" ]; then
  shift
  if ! unshare -rn true 2>/dev/null; then
    echo "SKIPPED: network namespaces cannot be made here (unshare -rn)"
    [ "${CI:-}" = "true" ] && exit 1
    exit 77
  fi
  exec unshare -rn sh -c 'ip link set lo up && ip link set lo multicast on && ip route add 239.0.0.0/8 dev lo && exec "$@"' \
    sh "$0" "$@"
fi
python="$here/../../.venv/bin/python"
[ -x "$python" ] || python=python3
modules=$1
shift
if ! "$python" -c "import $modules" 2>/dev/null; then
  echo "SKIPPED: Python peers ($modules) are not installed: scripts/setup --peers"
  [ "${CI:-}" = "true" ] && exit 1
  exit 77
fi
exec "$python" "$@"
