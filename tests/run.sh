#!/bin/sh
# Set up a Debian 12 machine and pass the tests:  tests/run.sh [release|asan|tsan]...
# Without arguments: the whole suite in release mode, then the C tests again under AddressSanitizer and UBSan.
# ctest's summary comes last; the exit status is 0 only if every test passed.
set -eu
cd "$(dirname -- "$0")/.."
docs/install_packages.sh

one() { # preset, target, ctest arguments...
    preset=$1
    target=$2
    shift 2
    build=build
    [ "$preset" = release ] || build=build-$preset
    cmake --preset "$preset" >"$build.log" 2>&1 || { cat "$build.log"; exit 1; }
    cmake --build "$build" --target "$target" || exit 1
    ctest --test-dir "$build" --output-on-failure --no-tests=error -j "$(nproc)" "$@" || failed=1
}

failed=0
if [ $# -eq 0 ]; then
    one asan sanitized_tests -L sanitize
    one release all
else
    for preset in "$@"; do
        case $preset in
        release) one release all ;;
        asan) one asan all ;;
        tsan) one tsan all -L threads ;;
        *) echo "usage: tests/run.sh [release|asan|tsan]..." >&2; exit 1 ;;
        esac
    done
fi
exit $failed
