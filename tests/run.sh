#!/bin/sh
# Installs packages, builds and runs all default tests.
#
#   tests/run.sh [preset] [ctest options]    preset: release (default), debug, asan or tsan
set -eu
root=$(cd "$(dirname "$0")/.." && pwd)
preset=release
case "${1:-}" in
  release | debug | asan | tsan)
    preset=$1
    shift
    ;;
esac

step() { echo "==> $*" >&2; }

step "1/3 packages"
"$root/deploy/install-packages.sh"

step "2/3 build (build/$preset; several minutes the first time)"
cd "$root"
[ "$preset" != tsan ] || tests/tsan_tbb.sh build/tsan-tbb
cmake --preset "$preset" -DSHADOWFIT_TESTS=ON >/dev/null
cmake --build --preset "$preset"

step "3/3 tests"
# Tests of deadlines and drains can fail where the machine stands still for a moment; twice in a row is a fault.
exec ctest --preset "$preset" --repeat until-pass:2 "$@"
