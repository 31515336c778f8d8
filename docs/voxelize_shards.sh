#!/bin/sh
# Voxelize in N shards with GNU parallel and join them.
#
#     voxelize_shards.sh N OUT.svo MESH... --depth D [options of svo-voxelize]
#
# JOBS: shards at a time (default: one for each processor); each uses one thread. PARALLEL_OPTIONS: more options of parallel, for
# instance --sshlogin for machines that share this folder. Shards are made in OUT.svo.shards and kept until they have been
# joined, so that a run that was interrupted goes on where it stopped; shards of other inputs or options are never mixed in.
set -eu
[ $# -ge 3 ] || { echo "usage: voxelize_shards.sh N OUT.svo MESH... --depth D [options]" >&2; exit 1; }
count=$1 out=$2
shift 2
key=$(svo-voxelize "$@" --key)
folder=$out.shards/$key-$count
mkdir -p "$folder"
one='i=$1 folder=$2 count=$3
shift 3
test -e "$folder/$i.svo" || exec svo-voxelize "$@" --threads 1 --shard "$i/$count" -o "$folder/$i.svo"'
# shellcheck disable=SC2086
seq "$count" | parallel -q ${PARALLEL_OPTIONS:-} -j "${JOBS:-100%}" --halt soon,fail=1 sh -c "$one" sh '{}' "$folder" "$count" "$@"
seq "$count" | sed "s|.*|$folder/&.svo|" | svo-merge --list - -o "$out" --force
rm -r "$folder"
rmdir "$out.shards" 2>/dev/null || true
