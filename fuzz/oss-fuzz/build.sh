#!/bin/bash -eu
# Builds every target, with its corpus and its dictionary beside it. OSS-Fuzz sets OUT, and the flags in the environment.
#
# It runs anywhere: OUT=$PWD/fuzz/out bash fuzz/oss-fuzz/build.sh, from the root of the project.
mkdir -p "$OUT"
export RUSTUP_TOOLCHAIN=${RUSTUP_TOOLCHAIN:-nightly}
cargo fuzz build -O --debug-assertions
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
triple=$(rustc -vV | sed -n 's/^host: //p')
built=${CARGO_TARGET_DIR:-fuzz/target}/$triple/release
for target in $(cargo fuzz list); do
    case $target in text | rac_line | rac_client | roundtrip_text) dictionary=text ;; *) dictionary=binary ;; esac
    cp "$built/$target" "$OUT/"
    cp "fuzz/dictionaries/$dictionary.dict" "$OUT/$target.dict"
    mkdir -p "$work/corpus" "$work/regressions"
    tar -xf "fuzz/corpus/$target.tar" -C "$work/corpus"
    if [ -d "fuzz/regressions/$target" ]; then cp -r "fuzz/regressions/$target" "$work/regressions/"; fi
    (cd "$work" && python3 -m zipfile -c "$OUT/${target}_seed_corpus.zip" corpus regressions && rm -r corpus regressions)
    printf '[libfuzzer]\nmax_len = 1024\ntimeout = 20\n' >"$OUT/$target.options"
done
