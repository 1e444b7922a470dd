#!/usr/bin/env bash
# Compares points, tables and statistics of two runs byte by byte. Reports and pages, which state times, are left out.
#
#     packaging/compare_outputs.sh out/demo OTHER_FOLDER
#     packaging/compare_outputs.sh --other-library out/demo OTHER_FOLDER
#
# Both folders must have the same file names, and simulated truth. Programs with another C library round some functions
# differently: the truth has the same bytes, but the sizes of other outputs may differ by 1 %.
set -euo pipefail
tolerance=0
if [ "$1" = --other-library ]; then
    tolerance=1
    shift
fi
diff <(ls "$1") <(ls "$2") >&2
compgen -G "$1/*_truth.csv" > /dev/null || { echo "$1 has no truth: set simulate.truth" >&2; exit 1; }
same=0
near=0
for file in "$1"/*; do
    case "$file" in
        *.laz | *.las | *.parquet | *.csv | *.txt) other="$2/${file##*/}" ;;
        *) continue ;;
    esac
    if cmp --silent "$file" "$other"; then
        same=$((same + 1))
        continue
    fi
    size="$(stat -c %s "$file")"
    other_size="$(stat -c %s "$other")"
    difference=$((size - other_size))
    if [ $tolerance = 0 ] || [[ "$file" = *_truth.csv ]] || [ $((${difference#-} * 100)) -gt "$other_size" ]; then
        cmp "$file" "$other" >&2
        exit 1
    fi
    echo "${file##*/}: $size bytes, $other_size bytes from the other program"
    near=$((near + 1))
done
[ $((same + near)) -ge 3 ] || { echo "$1 has only $((same + near)) outputs to compare" >&2; exit 1; }
echo "outputs with the same bytes: $same of $((same + near))"
