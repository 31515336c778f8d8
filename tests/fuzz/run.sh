#!/bin/sh
# Fuzz every target, one after the other, on one core:  tests/fuzz/run.sh [--engine libfuzzer|afl] BUILD SECONDS [TARGET...]
# BUILD is a build folder configured with SVO_BUILD_FUZZERS (ON, or afl for --engine afl). Corpora are kept in BUILD/corpus (afl: BUILD/afl),
# findings in BUILD/findings, logs in BUILD/logs; a line per target is printed at the end. The exit status is 1 when something was found.
set -u
here=$(cd "$(dirname -- "$0")" && pwd)
engine=libfuzzer
[ "${1-}" != --engine ] || { engine=${2-}; shift 2; }
case $engine in libfuzzer | afl) ;; *) set -- ;; esac
[ $# -ge 2 ] || { sed -n 2,4p "$0" >&2; exit 1; }
build=$(cd "$1" && pwd) seconds=$2
shift 2
found=0
[ $# -gt 0 ] || set -- $(cd "$here/targets" && ls ./*.c | sed 's|^\./||; s|\.c$||')
for target in "$@"; do # a target that is newer than the folder's seeds has none
    [ -d "$build/seeds/$target" ] || python3 "$here/make_seeds.py" "$build/tools" "$build/seeds" || exit 1
done
mkdir -p "$build/findings" "$build/logs" "$build/corpus"

libfuzzer() { # target, dictionary or nothing
    old=
    [ ! -d "$here/regressions/$1" ] || old=$here/regressions/$1
    mkdir -p "$build/corpus/$1"
    # jansson, libpng and others may be asked for more than there is: a NULL is what they get then
    ASAN_OPTIONS=allocator_may_return_null=1 nice -n 19 "$build/tests/fuzz/fuzz_$1" ${2:+-dict="$2"} -max_total_time="$seconds" -max_len=16384 -timeout=10 -rss_limit_mb=1024 \
        -malloc_limit_mb=512 -print_final_stats=1 -verbosity=1 -artifact_prefix="$build/findings/$1-" "$build/corpus/$1" $old "$build/seeds/$1" >"$build/logs/$1.log" 2>&1
    status=$?
    [ $status -eq 0 ] || found=1
    printf '%-11s exit %d, %s executions, %s edges, peak %s MB\n' "$1" $status "$(sed -n 's/^stat::number_of_executed_units: *//p' "$build/logs/$1.log")" \
        "$(grep -ao 'cov: [0-9]*' "$build/logs/$1.log" | tail -n 1 | cut -d ' ' -f 2)" "$(sed -n 's/^stat::peak_rss_mb: *//p' "$build/logs/$1.log")"
}

afl_stat() { sed -n "s/^$2 *: //p" "$build/afl/$1/default/fuzzer_stats"; }

# AFL++ goes on from its last run in BUILD/afl/TARGET. The mutators of this folder know hashes: for our own files AFL's own changes would be refused at once.
afl() {
    in=$build/afl-in/$1
    rm -rf "$in"
    mkdir -p "$in" "$build/afl/$1"
    for folder in "$here/regressions/$1" "$build/seeds/$1" "$build/corpus/$1"; do
        [ ! -d "$folder" ] || find "$folder" -type f -size -16k -exec cp -t "$in" {} +
    done
    mutator=
    case $1 in
    container | svo | svdag | svscene | skel) mutator="AFL_CUSTOM_MUTATOR_LIBRARY=$build/tests/fuzz/afl_mutate_container.so AFL_CUSTOM_MUTATOR_ONLY=1 AFL_DISABLE_TRIM=1" ;;
    image) mutator="AFL_CUSTOM_MUTATOR_LIBRARY=$build/tests/fuzz/afl_mutate_image.so" ;;
    esac
    env $mutator ASAN_OPTIONS=abort_on_error=1:symbolize=0:detect_leaks=0:allocator_may_return_null=1:max_allocation_size_mb=512 AFL_AUTORESUME=1 AFL_NO_UI=1 AFL_SKIP_CPUFREQ=1 \
        AFL_NO_AFFINITY=1 AFL_I_DONT_CARE_ABOUT_MISSING_CRASHES=1 AFL_IGNORE_PROBLEMS=1 AFL_FAST_CAL=1 \
        nice -n 19 afl-fuzz -i "$in" -o "$build/afl/$1" ${2:+-x "$2"} -m none -t 10000 -G 16384 -V "$seconds" -- "$build/tests/fuzz/fuzz_$1" >"$build/logs/afl-$1.log" 2>&1
    status=$?
    for kind in crashes hangs; do
        for f in "$build/afl/$1/default/$kind"/id*; do
            [ ! -f "$f" ] || { cp "$f" "$build/findings/$1-afl-$kind-$(basename "$f" | cut -d , -f 1 | tr : -)"; found=1; }
        done
    done
    [ $status -eq 0 ] || found=1
    printf '%-11s exit %d, %s executions, %s of %s edges, %s crashes, %s hangs, %s inputs\n' "$1" $status "$(afl_stat "$1" execs_done)" "$(afl_stat "$1" edges_found)" \
        "$(afl_stat "$1" total_edges)" "$(afl_stat "$1" saved_crashes)" "$(afl_stat "$1" saved_hangs)" "$(afl_stat "$1" corpus_count)"
}

for t; do
    if [ ! -x "$build/tests/fuzz/fuzz_$t" ]; then
        echo "$t: not built" # of targets that need an optional library; else it is an error
        [ "$t" = exr ] || found=1
        continue
    fi
    case $t in container | svo | svdag | svscene | skel) words=container ;; *) words=$t ;; esac
    dictionary=$here/dictionaries/$words.dict
    [ -f "$dictionary" ] || dictionary=
    $engine "$t" "$dictionary"
done
exit $found
