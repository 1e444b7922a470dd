#!/usr/bin/env bash
# Runs the program of an archive for Windows under Wine, and compares its outputs with those of another program.
#
#     packaging/check_windows.sh wavex-0.1.0-x86_64-windows.zip target/release/wavex
set -euo pipefail
archive="$(realpath "$1")"
other="$(realpath "$2")"
cd "$(dirname "$0")"
# Debian's package `wine64` alone has its programs in this folder.
export PATH="$PATH:/usr/lib/wine"
command -v wine64 > /dev/null ||
    { echo 'SKIPPED: the program for Windows does not run here: install Wine (Debian: wine64)'; exit 0; }
work="$(mktemp -d)"
truth=(--set 'simulate.truth=*_truth.csv')
# Wine's server writes into the folder for some seconds after the last program.
trap 'wineserver -k || true; rm -rf "$work"' EXIT
export WINEPREFIX="$work/wine" WINEDEBUG=-all
unset DISPLAY
# Wine unpacks its system first.
wine64 wineboot --init > "$work/wineboot.log" 2>&1 || { tail -5 "$work/wineboot.log"; exit 1; }
python3 -m zipfile -e "$archive" "$work/archive"
cd "$work"/archive/*
# Wine before version 9 lacks a library of Windows 8 and later with one function, which the standard library calls.
if [ ! -e "$WINEPREFIX/drive_c/windows/system32/bcryptprimitives.dll" ]; then
    x86_64-w64-mingw32-gcc -shared -o bcryptprimitives.dll -x c - -ladvapi32 << 'C'
#include <windows.h>
#include <ntsecapi.h>
__declspec(dllexport) BOOL ProcessPrng(PBYTE data, SIZE_T size) { return RtlGenRandom(data, size); }
C
fi
wine64 wavex.exe doctor
wine64 wavex.exe --quiet run "${truth[@]}" jobs/demo.toml
"$other" --quiet run "${truth[@]}" --set "job.output_dir=$work/other" jobs/demo.toml
"$OLDPWD/compare_outputs.sh" --other-library out/demo "$work/other"
echo "the program for Windows works under $(wine64 --version)"
