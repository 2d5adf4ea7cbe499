# Recipes. CI runs the same parts through `.ci/run`.

# Lists the recipes.
default:
    @just --list

# All checks that a change must pass.
ci:
    bash .ci/run

# Evidence that takes hours: packages, fuzzing, fresh random cases, tests of real time, power cuts. `SEED=1 just nightly` repeats a run.
nightly:
    bash .ci/run nightly

# A virtual controller, a session with it, and every frame decoded beside its bytes.
demo:
    cargo run --release -p bcap-cli -- demo

# All tests.
test:
    cargo test --workspace

# Formats the code.
format:
    cargo fmt --all
    cargo fmt --all --manifest-path tests/no-panic/Cargo.toml
    cargo fmt --manifest-path fuzz/Cargo.toml
    cargo fmt --manifest-path embassy-adapter/firmware/Cargo.toml
    cargo fmt --manifest-path embassy-adapter/firmware/sizes/Cargo.toml

# Format check, and clippy over every feature set, with warnings as errors.
lint:
    bash .ci/run format lint

# Documentation, with warnings as errors.
doc:
    bash .ci/run doc

# The book, with its commands, links and pages checked. `mdbook` writes it into book/.
book:
    bash .ci/run book

# Common misspellings, by the word list of typos; `_typos.toml` has the words that are right here.
spelling:
    bash .ci/run spelling

# Searches linked images of the core for panic paths.
no-panic:
    bash .ci/run no-panic

# Instructions per operation under callgrind, against their bars.
instructions:
    bash .ci/run instructions

# Encoding and decoding of large arrays, compared with memcpy.
arrays:
    cargo bench -p bcap-tests --bench arrays

# Objects of `bcap sim`: times with 1,200 and with 100,000 open, memory, requests per second of 100 clients.
objects:
    cargo build --release -p bcap-cli
    BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo bench -p bcap-tests --bench objects

# How long a small call waits while another client sends requests of 16 MiB.
fairness:
    cargo bench -p bcap-tests --bench fairness

# Random programs of motions with each arm: no axis exceeds its speed or leaves its range.
programs count="10000":
    PROGRAMS={{count}} cargo test --release -p bcap-sim --test all robot::random::no_axis

# Random scenarios with 1,000 random calls each, three times: the same records.
scenarios count="100":
    PROGRAMS={{count}} cargo test --release -p bcap-sim --test all determinism::

# Draws the figures of docs/motion.md again.
figures:
    FIGURES=write cargo test -p bcap-sim --test all figures::

# What `bcap proxy` adds to a round trip.
proxy:
    cargo bench -p bcap-cli --bench proxy

# Slave Mode in real time through `bcap proxy`, which records: an hour, or `just proxy-slave 1` for a minute. It fails on an underflow.
proxy-slave minutes="60":
    MINUTES={{minutes}} cargo test --release -p bcap-cli --test all proxy_load:: -- --ignored --nocapture

# A stream in real time with errors, doctor, monitor, fleet and a gateway, on a controller that ends Slave Mode at each refused call.
stream-and-monitors:
    cargo test --release -p bcap-cli --test all monitors:: -- --ignored --nocapture

# Round trips over loopback compared with a bare ping-pong, and a server with 100 connections.
loopback:
    cargo bench -p bcap-tests --bench loopback

# The time from a halt to the request and to rest, and what the waiting code is told, in 1,000 random trials.
halt:
    cargo bench -p bcap-tests --bench halt -- 1000

# Random trials of how programs and `bcap` end while they move a robot, 2,000 with each model: `just endings [TRIALS] [SEED]`,
# or `just endings --only N` for one of them.
endings *args:
    cargo build --release -p bcap-cli
    BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo bench -p bcap-tests --bench endings -- {{args}}

# Pick and place with passes, legs of 5 to 50 mm, speeds of 5 to 100 %, on a busy machine: every cycle arrives.
pick-and-place cycles="100":
    cargo bench -p bcap-tests --bench endings -- pick-and-place {{cycles}}

# Processor time of a client and a gateway under a flood of S_EXECUTING, in 5 s each.
flood:
    cargo bench -p bcap-tests --bench flood

# How well streams of Slave Mode keep the cycle of 8 ms beside a busy core: every mode, blocking and tokio, 80 s each.
slave cycles="10000":
    cargo bench -p bcap-tests --bench slave -- {{cycles}}

# Requests through the gateway board in QEMU, compared with a bare echo on it; `bash .ci/run firmware` installs the tools.
board:
    cargo build --release -p bcap-cli
    BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo bench -p bcap-qemu --bench gateway

# The gateway board in QEMU with four PLCs while the robot, the link and other clients fail at random: an hour, or `just board-soak 1`.
board-soak minutes="60" seed="1":
    cargo build --release -p bcap-cli
    SOAK_SECONDS=$(({{minutes}} * 60)) SOAK_SEED={{seed}} BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" \
        cargo test -p bcap-qemu soak::

# A client that sends refused PUTs to the gateway board in QEMU as fast as it can, and a PLC beside it: ten minutes, or `just board-flood 1`.
board-flood minutes="10":
    cargo build --release -p bcap-cli
    FLOOD_SECONDS=$(({{minutes}} * 60)) BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" \
        cargo test -p bcap-qemu flood::

# Updates of the gateway board in QEMU with the power cut in each operation of a swap and a roll-back, and in many of a download: 45 minutes.
board-updates:
    cargo build --release -p bcap-cli
    UPDATE_CUTS=all BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo test -p bcap-qemu update:: -- --nocapture

# Virtual controllers, `bcap-fleet`, Mosquitto and a subscriber on this machine: values a second, processor time, memory, latency.
fleet controllers="500" values="20" hz="5" seconds="10":
    cargo bench -p bcap-fleet --bench plant -- {{controllers}} {{values}} {{hz}} {{seconds}}

# Each fuzz target for half a minute, or for `just fuzz 1200` seconds.
fuzz seconds="30":
    FUZZ_SECONDS={{seconds}} bash .ci/run fuzz

# How long `bcap fuzz` takes to find each of 35 planted bugs: minutes.
planted:
    cargo test --release -p bcap-cli --test all fuzz:: -- --ignored --nocapture

# The corpora of the fuzz targets: `just corpora unpack` writes the archives' inputs to folders, `just corpora pack` the reverse.
corpora action:
    cargo run --quiet --locked --manifest-path fuzz/Cargo.toml --no-default-features --example corpora -- {{action}}

# A hundred thousand calls over UDP; one datagram in ten is lost, one in ten duplicated.
lossy calls="100000":
    UDP_CALLS={{calls}} cargo test -p bcap-tests --test all datagrams_are_lost -- --nocapture

# Values and a file of 256 KiB over a serial cable of 115200 baud that corrupts one byte in 10,000, then 10 s of Slave Mode at 921600.
serial:
    cargo test --release -p bcap-tests --test all serial_cable:: -- --ignored --nocapture --test-threads 1
    cargo test --release -p bcap-cli --test all serial:: -- --ignored --nocapture

# Two hundred clients for a minute, or for `just soak 36000` seconds; half of them misbehave.
soak seconds="60":
    cargo bench -p bcap-tests --bench soak -- --seconds {{seconds}}

# Line coverage of the corpora of a fuzz target: `just coverage text`. Needs nightly's llvm-tools.
coverage target:
    bash fuzz/measure-coverage {{target}}

# All 2^32 values of every length and count, and the edges with 32-bit addresses (needs Debian's gcc-multilib).
lengths:
    cargo test --release -p bcap-tests --test all lengths:: -- --ignored
    rustup target add i686-unknown-linux-gnu
    cargo test -p bcap-core --lib --target i686-unknown-linux-gnu
    cargo test -p bcap-tests --test all --target i686-unknown-linux-gnu -- lengths:: vectors::

# Prints and parses every 1000th float (`just floats 1`: all of them, half an hour), and the milliseconds of some days.
floats step="1000":
    BCAP_STEP={{step}} cargo test --release -p bcap-core --lib -- --ignored

# Mutation tests of a file of the core: `just mutants core/src/bcap/frame.rs`.
mutants file shard="0/1":
    cargo install --locked cargo-mutants@27.1.0
    cargo mutants -p bcap-core --file {{file}} --sharding round-robin --shard {{shard}} --timeout 120 --jobs 1 -- --lib

# The core's tests under Miri. All take hours; a filter selects some: `just miri bcap::frame`.
miri filter="":
    rustup component add --toolchain nightly miri rust-src
    cargo +nightly miri test -p bcap-core --lib -- {{filter}}

# The tests of the std adapter under AddressSanitizer, and under ThreadSanitizer with an instrumented std.
sanitizers:
    rustup component add --toolchain nightly rust-src
    RUSTFLAGS=-Zsanitizer=address CARGO_TARGET_DIR=target/asan \
        cargo +nightly test -p bcap-std --all-features --lib --tests --target x86_64-unknown-linux-gnu
    RUSTFLAGS=-Zsanitizer=thread CARGO_TARGET_DIR=target/tsan \
        cargo +nightly test -Zbuild-std -p bcap-std --all-features --lib --tests --target x86_64-unknown-linux-gnu

# Licences, sources and advisories of the dependencies.
dependencies:
    bash .ci/run dependencies

# The gateway board in QEMU for a minute on a link that drops, repeats and delays frames; a seed decides which.
wire seed="1":
    cargo build --quiet --locked --release -p bcap-cli
    WIRE_SECONDS=60 WIRE_SEED={{seed}} BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo test -p bcap-qemu wire::

# Checks a release, as RELEASING.md describes; with `--execute` tags and publishes it: `just release 0.2.0 --execute`.
release version execute="":
    #!/usr/bin/env bash
    set -euo pipefail
    fail() { echo "release: $*" >&2; exit 1; }
    [ -z "$(git status --porcelain)" ] || fail "the tree has changes that are not committed"
    grep -qx 'version = "{{version}}"' Cargo.toml || fail "[workspace.package] of Cargo.toml does not have the version {{version}}"
    grep -q '^## \[{{version}}\] - 20' CHANGELOG.md || fail "CHANGELOG.md has no section [{{version}}] with a date"
    grep -q '^repository = ' Cargo.toml || fail "Cargo.toml has no repository; see RELEASING.md"
    ! git rev-parse --quiet --verify 'refs/tags/v{{version}}' >/dev/null || fail "the tag v{{version}} exists"
    last=$(git describe --tags --abbrev=0 --match 'v*' 2>/dev/null || true)
    if [ -n "$last" ]; then
        cargo semver-checks --version >/dev/null 2>&1 || cargo install --locked cargo-semver-checks@0.49.0
        cargo semver-checks --baseline-rev "$last" -p bcap-core -p bcap-gateway -p bcap-sim -p bcap-std -p bcap-capture -p bcap-conform -p bcap-embassy -p bcap-board -p bcap-testkit -p bcap-terminal -p bcap-fleet
    fi
    bash .ci/run packages
    packages=(-p bcap-core -p bcap-gateway -p bcap-sim -p bcap-std -p bcap-capture -p bcap-conform -p bcap-embassy -p bcap-board -p bcap-testkit -p bcap-terminal -p bcap-fleet -p bcap-cli)
    case "{{execute}}" in
        --execute)
            cargo publish --locked --no-verify "${packages[@]}"
            git tag --annotate --message 'release {{version}}' 'v{{version}}' ;;
        "") cargo publish --locked --no-verify --dry-run "${packages[@]}" ;;
        *) fail "unknown argument {{execute}}" ;;
    esac

# A Debian package with static binaries, manual pages, completions and units for the gateway and the fleet.
debian:
    std-adapter/cli/packaging/debian

# Installs that package in an empty root, or in a Debian system in the directory `root`, and uses it there.
debian-test root="":
    std-adapter/cli/packaging/debian-test {{root}}

# A container image of the static binaries, if there is podman or buildah, and a test of its files in a chroot.
container:
    bash .ci/run container

# Builds the static binaries in two directories, and compares the bytes.
reproducible:
    std-adapter/cli/packaging/reproducible

# How long it takes until the standby of a fleet replaces a process that is killed or stopped, and until values arrive after
# a restart of the broker, with the default of `after_ms`. Needs Mosquitto.
takeover count="20":
    TAKEOVERS={{count}} cargo test --release -p bcap-fleet --test all standby::processes_that_are -- --nocapture

# A fleet whose broker, robots and network fail again and again: every fourth failure is one of the broker, and there are
# 50 commands for each. Prints what arrived, was dropped, and was executed. Needs Mosquitto.
chaos failures="200":
    FAILURES={{failures}} cargo test --release -p bcap-fleet --test all chaos:: -- --nocapture
