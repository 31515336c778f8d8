#!/bin/sh
# The table of docs/results: seven models of different kind at depths 10 to 13, in the current folder (about 450 MB).
#     SVOKIT_MODELS=... bench_steps.sh FOLDER_OF_TOOLS BENCH_STEPS OUT.csv
set -e
M=${SVOKIT_MODELS:?}; T=${1:?folder of the tools}; B=${2:?bench_steps}; OUT=${3:?file}
files=""
for d in 10 11 12 13; do
  for m in scan:E_formats/ply_bun_zipper/bun_zipper.ply statue:A_organic/armadillo/armadillo.obj building:F_big/sponza_low/Sponza_LowPoly.gltf \
           city:C_textured/virtual_city/VC.gltf tree:C_textured/oak_tree/oaktree.gltf product:C_textured/flight_helmet/FlightHelmet.gltf terrain:C_textured/terrain/terrain.glb; do
    n=${m%%:*}_$d
    "$T/svo-voxelize" "$M/${m#*:}" --depth $d --attributes none -q -o $n.svo -f && "$T/svo-compress" $n.svo --geometry svdag --lod stored -q -o $n.svdag -f && files="$files $n.svdag"
    rm -f $n.svo
  done
done
"$B" $files > "$OUT"
