#!/bin/bash -eu
# Builds every target, with its corpus and its dictionary beside it. OSS-Fuzz sets OUT, and the flags in the environment.
#
# It runs anywhere: OUT=$PWD/fuzz/out bash fuzz/oss-fuzz/build.sh, from the root of the project.
mkdir -p "$OUT"
export RUSTUP_TOOLCHAIN=${RUSTUP_TOOLCHAIN:-nightly}
cargo fuzz build -O --debug-assertions
triple=$(rustc -vV | sed -n 's/^host: //p')
built=${CARGO_TARGET_DIR:-fuzz/target}/$triple/release
for target in $(cargo fuzz list); do
    case $target in text | rac_line | rac_client | roundtrip_text) dictionary=text ;; *) dictionary=binary ;; esac
    cp "$built/$target" "$OUT/"
    cp "fuzz/dictionaries/$dictionary.dict" "$OUT/$target.dict"
    corpus=("fuzz/corpus/$target")
    if [ -d "fuzz/regressions/$target" ]; then corpus+=("fuzz/regressions/$target"); fi
    (cd fuzz && python3 -m zipfile -c "$OUT/${target}_seed_corpus.zip" "${corpus[@]#fuzz/}")
    printf '[libfuzzer]\nmax_len = 1024\ntimeout = 20\n' >"$OUT/$target.options"
done
