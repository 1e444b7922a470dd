#!/usr/bin/env bash
# Compares points, tables and statistics of two runs byte by byte. Reports and pages, which state times, are left out.
#
#     packaging/compare_outputs.sh out/demo OTHER_FOLDER
set -euo pipefail
same=0
for file in "$1"/*; do
    case "$file" in
        *.laz | *.las | *.parquet | *.csv | *.txt) cmp "$file" "$2/${file##*/}" && same=$((same + 1)) ;;
    esac
done
[ "$same" -ge 3 ] || { echo "$1 has only $same outputs to compare" >&2; exit 1; }
echo "$same outputs have the same bytes"
