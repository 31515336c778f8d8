#!/bin/sh
# The same bytes from other compilers and optimization: builds svo-voxelize with gcc and clang at -O0 to -O3 and compares what they write.
# Not a part of ctest, because it builds the libraries eight times.
#   tests/compilers.sh BUILD_FOLDER [MESH...]      (without meshes: what the folder of real models has, else a generated one)
set -eu
source=$(cd "$(dirname "$0")/.." && pwd)
[ $# -ge 1 ] || { sed -n '2,4s/^# \{0,1\}//p' "$0"; exit 1; }
build=$1
shift
mkdir -p "$build"
build=$(cd "$build" && pwd)
if [ $# -eq 0 ]; then
    models=${SVOKIT_MODELS:-$source/../shared/models}
    for m in A_organic/horse/horse.ply C_textured/spot_cow/spot_triangulated.obj C_textured/flight_helmet/FlightHelmet.gltf C_textured/oak_tree/oaktree.gltf; do
        [ -e "$models/$m" ] && set -- "$@" "$models/$m"
    done
fi
if [ $# -eq 0 ]; then
    awk 'BEGIN { srand(7); for (i = 0; i < 6000; i++) printf "v %.9f %.9f %.9f\n", rand(), rand(), rand(); for (i = 0; i < 2000; i++) printf "f %d %d %d\n", 3*i+1, 3*i+2, 3*i+3 }' \
        > "$build/random.obj"
    set -- "$build/random.obj"
fi
configurations=
for c in gcc clang; do
    command -v $c > /dev/null || { echo "no $c: left out"; continue; }
    x=g++; [ $c = clang ] && x=clang++
    for o in O0 O1 O2 O3; do
        configurations="$configurations $c-$o"
        cmake -S "$source" -B "$build/$c-$o" -DCMAKE_C_COMPILER=$c -DCMAKE_CXX_COMPILER=$x -DCMAKE_BUILD_TYPE=None -DCMAKE_C_FLAGS=-$o -DCMAKE_CXX_FLAGS=-$o \
            -DSVO_BUILD_TESTS=OFF ${CMAKE_ARGS:-} > "$build/$c-$o.log" 2>&1 && cmake --build "$build/$c-$o" --target svo-voxelize -j "${JOBS:-2}" >> "$build/$c-$o.log" 2>&1 ||
            { tail -20 "$build/$c-$o.log"; exit 1; }
    done
done
failed=0 compared=0
for mesh in "$@"; do
    for how in "--depth 6" "--depth 9" "--depth 9 --surface thin --attributes none" "--depth 12 --attributes none"; do
        sums=
        for c in $configurations; do
            # shellcheck disable=SC2086
            "$build/$c/tools/svo-voxelize" "$mesh" -o "$build/$c.svo" -f -q $how
            sums="$sums$(cksum < "$build/$c.svo") $c
"
        done
        compared=$((compared + 1))
        if [ "$(printf %s "$sums" | cut -d' ' -f1,2 | sort -u | wc -l)" -ne 1 ]; then
            echo "DIFFERENT: $(basename "$mesh") $how"
            printf %s "$sums"
            failed=1
        fi
    done
done
echo "$compared outputs compared between:$configurations"
exit $failed
