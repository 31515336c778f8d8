#!/bin/sh
# Fuzz every target, one after the other, on one core:  tests/fuzz/run.sh BUILD SECONDS [TARGET...]
# BUILD is a build folder configured with SVO_BUILD_FUZZERS. Corpora are kept in BUILD/corpus, findings in BUILD/findings,
# logs in BUILD/logs; a line per target is printed at the end. The exit status is 1 when something was found.
set -u
here=$(cd "$(dirname -- "$0")" && pwd)
[ $# -ge 2 ] || { sed -n 2,4p "$0" >&2; exit 1; }
build=$(cd "$1" && pwd) seconds=$2
shift 2
found=0
[ -d "$build/seeds" ] || python3 "$here/make_seeds.py" "$build/tools" "$build/seeds" || exit 1
[ $# -gt 0 ] || set -- $(cd "$here/targets" && ls ./*.c | sed 's|^\./||; s|\.c$||')
mkdir -p "$build/findings" "$build/logs"
for t; do
    case $t in container | svo | svdag | svscene | skel) words=container ;; *) words=$t ;; esac
    dictionary=
    [ ! -f "$here/dictionaries/$words.dict" ] || dictionary=-dict=$here/dictionaries/$words.dict
    mkdir -p "$build/corpus/$t"
    old=
    [ ! -d "$here/regressions/$t" ] || old=$here/regressions/$t
    # jansson, libpng and others may be asked for more than there is: a NULL is what they get then
    ASAN_OPTIONS=allocator_may_return_null=1 nice -n 19 "$build/tests/fuzz/fuzz_$t" $dictionary -max_total_time="$seconds" -max_len=16384 -timeout=10 -rss_limit_mb=1024 \
        -malloc_limit_mb=512 -print_final_stats=1 -verbosity=1 -artifact_prefix="$build/findings/$t-" "$build/corpus/$t" $old "$build/seeds/$t" >"$build/logs/$t.log" 2>&1
    status=$?
    [ $status -eq 0 ] || found=1
    printf '%-11s exit %d, %s executions, %s edges, peak %s MB\n' "$t" $status "$(sed -n 's/^stat::number_of_executed_units: *//p' "$build/logs/$t.log")" \
        "$(grep -o 'cov: [0-9]*' "$build/logs/$t.log" | tail -n 1 | cut -d ' ' -f 2)" "$(sed -n 's/^stat::peak_rss_mb: *//p' "$build/logs/$t.log")"
done
exit $found
