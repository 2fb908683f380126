#!/usr/bin/env bash
# Everything that only a machine with a graphics card can tell: finds the card, runs the GPU's tests on it, measures it beside
# the CPU and holds pictures from both against each other. Writes one JSON file with all of it.
#
#   tests/gpu.sh [--software] [--out FILE] [--size WxH] [--rounds N] [--programs FOLDER]
#   tests/gpu.sh --build FOLDER
#
#   --software    a driver that computes on the CPU (Mesa's lavapipe) may stand for a card
#   --out FILE    where the JSON goes; gpu.json where the command is run, if left out
#   --size WxH    size of measured passes; 1920x1080, with a software driver 640x360, if left out
#   --rounds N    rounds of everything that is measured, of which the median counts; 5 if left out
#   --build FOLDER     builds what is run here into FOLDER, and ends: for a machine with a card and without Rust
#   --programs FOLDER  runs what --build made, and builds nothing
#   --help        this text
#
# Needs Rust, unless --programs is given, and a driver for Vulkan, Metal or DirectX 12; installs nothing. Scenes are the built-in
# box and, where ../shared or $LUMICAST_SHARED is there, four of its scenes. Ends with 1 and names what failed if anything did; the rest is run and written all the same.
set -uo pipefail
started_in=$PWD
cd "$(dirname "$0")/.." || exit 1

help() { sed -n '2,/^set/p' "$0" | sed -e '/^set/d' -e 's/^# \{0,1\}//'; }
refuse() { echo "error: $1 (--help lists what there is)" >&2; exit 2; }

out=gpu.json software=() measured=() programs='' built=''
while [ $# -gt 0 ]; do
    case "$1" in
        --out | --build | --programs | --size | --rounds) [ $# -gt 1 ] || refuse "$1: a value is missing" ;;
    esac
    case "$1" in
        --software) software=(--software) ;;
        --out) out=$2; shift ;;
        --build) built=$2; shift ;;
        --programs) programs=$2; shift ;;
        --size | --rounds)
            case "$1 $2" in
                --size\ *[!0-9x]* | --size\ *x*x* | --size\ x* | --size\ *x) refuse "--size $2: write it as 1280x720" ;;
                --size\ *x* | --rounds\ [1-9] | --rounds\ [1-9][0-9]) measured+=("$1" "$2") ;;
                --size*) refuse "--size $2: write it as 1280x720" ;;
                *) refuse "--rounds $2: 1 to 99" ;;
            esac
            shift
            ;;
        --help | -h) help; exit 0 ;;
        *) refuse "$1: no such option" ;;
    esac
    shift
done
from_start() { case "$1" in '' | /*) printf '%s' "$1" ;; *) printf '%s' "$started_in/$1" ;; esac; }
out=$(from_start "$out") programs=$(from_start "$programs") built=$(from_start "$built")
[ -z "$programs" ] || [ -z "$built" ] || refuse "--build and --programs: one of them"
for program in lumicast bench shaders-tests engine-tests; do
    [ -z "$programs" ] || [ -x "$programs/$program" ] || refuse "--programs $programs: no program $program there, as --build makes it"
done
[ -d "$(dirname "$out")" ] || refuse "--out $out: there is no such folder"

work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
failures=()
failed() { failures+=("$1"); echo "FAILED $1" >&2; }
say() { printf '\n== %s\n' "$1" >&2; }
# Between quotes of JSON.
quoted() { printf '"%s"' "$(printf '%s' "$1" | tr '\n\t' '  ' | sed -e 's/\\/\\\\/g' -e 's/"/\\"/g')"; }

# What drivers kept of shaders from earlier runs would make compiling look free: Mesa's and NVIDIA's stores are left out.
bench() {
    MESA_SHADER_CACHE_DISABLE=true __GL_SHADER_DISK_CACHE=0 \
        "$programs/bench" --bench ${software[@]+"${software[@]}"} "$@"
}

# The program that cargo says it built, as argument 1 asks, to $programs/argument 2.
program() {
    local made
    made=$(cargo $1 --message-format=json-render-diagnostics | sed -n 's/.*"executable":"\([^"]*\)".*/\1/p' | tail -n 1)
    [ -n "$made" ] && cp "$made" "$programs/$2"
}
if [ -z "$programs" ]; then
    say "building"
    programs=${built:-$work/programs}
    mkdir -p "$programs" &&
        program "build --release -p lumicast --bin lumicast" lumicast &&
        program "bench --no-run -p lumicast-tests --bench gpu" bench &&
        program "test --release --no-run -p lumicast-shaders --lib" shaders-tests &&
        program "test --release --no-run -p lumicast-engine --lib" engine-tests || {
        echo "FAILED building" >&2
        exit 1
    }
    [ -z "$built" ] || exit 0
fi
lumicast=$programs/lumicast

# The bench would look beside the sources that it was built from.
shared=${LUMICAST_SHARED:-}
for folder in ../shared ../../shared; do [ -n "$shared" ] || [ ! -d "$folder/scenes" ] || shared=$(cd "$folder" && pwd); done
[ -z "$shared" ] || export LUMICAST_SHARED=$shared

say "the adapter"
if ! adapter=$(bench adapter 2>"$work/adapter"); then
    cat "$work/adapter" >&2
    failed "finding an adapter"
    printf '{"failed": ["finding an adapter"], "error": %s}\n' "$(quoted "$(cat "$work/adapter")")" >"$out"
    exit 1
fi
echo "$adapter"
case "$adapter" in *"(software,"*) is_software=yes ;; *) is_software=no ;; esac

say "tests"
tests_passed=true
LUMICAST_GPU=required "$programs/engine-tests" gpu 2>&1 | tee "$work/tests" >&2
[ "${PIPESTATUS[0]}" = 0 ] || { tests_passed=false; failed "tests of the engine"; }
"$programs/shaders-tests" 2>&1 | tee "$work/shaders" >&2
[ "${PIPESTATUS[0]}" = 0 ] || { tests_passed=false; failed "tests of the shaders"; }
test_count=$(sed -n 's/^test result: .* \([0-9]*\) passed.*/\1/p' "$work/tests" | awk '{ sum += $1 } END { print sum + 0 }')
[ "$test_count" -gt 0 ] || { tests_passed=false; failed "tests: none ran"; }

say "pictures"
scenes=(builtin:cornell-box)
shared=${shared:-../shared}
for file in sponza.glb sibenik.glb dragon-room.glb cornell-glass.glb; do
    if [ -f "$shared/scenes/$file" ]; then scenes+=("$shared/scenes/$file"); else echo "SKIPPED $file: not in $shared/scenes" >&2; fi
done
# As many paths as a software driver traces in some seconds.
if [ "$is_software" = yes ]; then picture=(--size 320x180 --samples 4); else picture=(--size 1280x720 --samples 64); fi
: >"$work/pictures"
for scene in "${scenes[@]}"; do
    name=$(basename "$scene")
    drawn=yes
    for backend in gpu cpu; do
        "$lumicast" render "$scene" "${picture[@]}" --backend "$backend" --out "$work/$backend.exr" >"$work/$backend.log" 2>&1 || {
            drawn=no
            cat "$work/$backend.log" >&2
            failed "drawing $name on the $backend"
        }
    done
    [ "$drawn" = yes ] || continue
    bench compare "$name" "$work/gpu.exr" "$work/cpu.exr" >"$work/compared" || failed "picture of $name"
    cat "$work/compared"
    # Each on a line of its own, to be joined below.
    cat "$work/compared" >>"$work/pictures"
done

# Whole records: where, light gathered, sums. The sets of them differ, as a card finds more at once: pictures are not compared.
say "records"
record_scenes=("${scenes[@]}") records=(--size 1280x720)
# A software driver takes minutes for more.
if [ "$is_software" = yes ]; then record_scenes=(builtin:cornell-box) records=(--size 64x36); fi
: >"$work/records"
for scene in "${record_scenes[@]}"; do
    name=$(basename "$scene")
    row="\"scene\": $(quoted "$name")"
    for backend in gpu cpu; do
        "$lumicast" render "$scene" "${records[@]}" --indirect irradiance --samples 1 --backend "$backend" \
            --out "$work/$backend.exr" --stats "$work/$backend.json" >"$work/$backend.log" 2>&1 || {
            cat "$work/$backend.log" >&2
            failed "records of $name on the $backend"
            continue 2
        }
        for figure in seconds:gather counts:records; do
            value=$(tr -d '\n' <"$work/$backend.json" |
                sed -n "s/.*\"${figure%:*}\": *{[^}]*\"${figure#*:}\": *\([0-9.e-]*\).*/\1/p")
            row="$row, \"${backend}_${figure#*:}\": ${value:-null}"
        done
    done
    echo "{$row}" | tee -a "$work/records"
done

say "measuring"
LUMICAST_GPU_JSON="$work/bench" bench ${measured[@]+"${measured[@]}"} || { failed "bench"; }
[ -s "$work/bench" ] || echo null >"$work/bench"

{
    printf '{\n"tests": {"passed": %s, "count": %s},\n' "$tests_passed" "$test_count"
    printf '"pictures": [%s],\n' "$(paste -sd, "$work/pictures")"
    printf '"picture_arguments": %s,\n' "$(quoted "${picture[*]}")"
    printf '"records": [%s],\n"record_arguments": %s,\n' "$(paste -sd, "$work/records")" "$(quoted "${records[*]}")"
    printf '"failed": ['
    separator=
    for failure in ${failures[@]+"${failures[@]}"}; do printf '%s%s' "$separator" "$(quoted "$failure")"; separator=', '; done
    printf '],\n"bench": '
    cat "$work/bench"
    printf '\n}\n'
} >"$out" || { failed "writing $out"; }
say "written to $out"

if [ "${#failures[@]}" -gt 0 ]; then
    printf 'FAILED: %s\n' "${failures[@]}" >&2
    exit 1
fi
