#!/bin/sh
# Runs clang-tidy, with the checks of .clang-tidy, over all our sources or those given; it must find nothing. Needs the
# release build, for what is generated.
#
#   tests/tidy.sh [FILE.cc ...]
set -eu
cd "$(dirname "$0")/.."
command -v clang-tidy >/dev/null || {
  echo "clang-tidy is missing: apt-get install clang-tidy" >&2
  exit 2
}
cmake --preset release >/dev/null
[ $# -gt 0 ] || set -- $(git ls-files '*.cc')

# Code for Highway's many targets is one source: to read it once is enough. What goes to stderr are counts of warnings
# in other people's headers.
printf '%s\n' "$@" | xargs -n 1 -P "$(nproc)" sh -c \
  'clang-tidy -p build/release --quiet --extra-arg=-DHWY_COMPILE_ONLY_STATIC "$0" 2>/dev/null || { echo "$0: not clean"; exit 1; }'
echo "clang-tidy is clean"
