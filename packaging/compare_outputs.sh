#!/usr/bin/env bash
# Compares points, tables and statistics of two runs byte by byte. Reports and pages, which state times, are left out.
#
#     packaging/compare_outputs.sh out/demo OTHER_FOLDER
#     packaging/compare_outputs.sh --other-library out/demo OTHER_FOLDER
#
# Programs with another C library round some functions differently: simulated truth has the same bytes, but the sizes of
# other outputs may differ by 1 %.
set -euo pipefail
tolerance=0
if [ "$1" = --other-library ]; then
    tolerance=1
    shift
fi
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
    difference=$(($(stat -c %s "$file") - $(stat -c %s "$other")))
    if [ $tolerance = 0 ] || [[ "$file" = *_truth.csv ]] || [ $((${difference#-} * 100)) -gt "$(stat -c %s "$other")" ]; then
        cmp "$file" "$other" >&2
        exit 1
    fi
    echo "${file##*/}: $(cmp -l "$file" "$other" | wc -l) bytes differ"
    near=$((near + 1))
done
[ $((same + near)) -ge 3 ] || { echo "$1 has only $((same + near)) outputs to compare" >&2; exit 1; }
echo "outputs with the same bytes: $same of $((same + near))"
