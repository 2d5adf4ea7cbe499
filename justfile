# Recipes for developers; `just` lists them. `bash .ci/run` runs all checks that a change must pass, `bash .ci/run PART...` some of
# them, such as `bash .ci/run lint test` or `bash .ci/run book`.

# Lists the recipes.
default:
    @just --list --unsorted

# A virtual controller, a session with it, and every frame decoded next to its bytes.
[group('develop')]
demo:
    cargo run -p bcap-capture --example demo

# All tests.
[group('develop')]
test:
    cargo test --workspace

# Formats the code.
[group('develop')]
format:
    cargo fmt --all
    cargo fmt --all --manifest-path tests/no-panic/Cargo.toml
    cargo fmt --manifest-path fuzz/Cargo.toml
    cargo fmt --manifest-path std-adapter/python/Cargo.toml
    cargo fmt --manifest-path embassy-adapter/firmware/Cargo.toml
    cargo fmt --manifest-path embassy-adapter/firmware/sizes/Cargo.toml

# Evidence that takes hours: packages, fuzzing, fresh random cases, tests of real time, power cuts. `SEED=1 just nightly` repeats a run.
[group('develop')]
nightly:
    bash .ci/run nightly

# Draws the figures of docs/motion.md again.
[group('develop')]
figures:
    FIGURES=write cargo test -p bcap-sim --test all figures::

# Encoding and decoding of large arrays, compared with memcpy.
[group('measure')]
arrays:
    cargo bench -p bcap-tests --bench arrays

# Objects of `bcap sim`: times with 1,200 and with 100,000 open, memory, requests per second of 100 clients.
[group('measure')]
objects:
    cargo build --release -p bcap-cli
    BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo bench -p bcap-tests --bench objects

# How long a small call waits while another client sends requests of 16 MiB.
[group('measure')]
fairness:
    cargo bench -p bcap-tests --bench fairness

# Instructions of the codec, the client and the server, by callgrind, against bars.
[group('measure')]
instructions:
    bash .ci/run instructions

# Flame graphs of a read and of a request on the server, as in docs/performance.md.
[group('measure')]
flame folder="target/flame":
    mkdir -p {{folder}}
    cargo build --profile bench -p bcap-instructions
    BCAP_CALLGRIND={{folder}} "${CARGO_TARGET_DIR:-$PWD/target}/release/client"
    BCAP_CALLGRIND={{folder}} "${CARGO_TARGET_DIR:-$PWD/target}/release/server"
    tests/instructions/flame --root client::main --title "a read, blocking client" {{folder}}/client-0-500.out {{folder}}/client-0-2500.out >{{folder}}/client.svg
    tests/instructions/flame --root server::main --title "a request, server" {{folder}}/server-1-500.out {{folder}}/server-1-2500.out >{{folder}}/server.svg

# Round trips over loopback compared with a bare ping-pong, and a server with 100 connections.
[group('measure')]
loopback:
    cargo bench -p bcap-tests --bench loopback

# The clients for Python, C and Rust, and one in pure Python, make the same calls by turns: calls a second, processor time, instructions.
[group('measure')]
speed rounds="100":
    #!/usr/bin/env bash
    set -euo pipefail
    target=${CARGO_TARGET_DIR:-$PWD/target}/speed
    cargo build --quiet --locked --release --lib --example calls --manifest-path std-adapter/c/Cargo.toml --target-dir "$target"
    cc -O2 -I std-adapter/c/include std-adapter/c/examples/calls.c "$target/release/libbcap.a" -lpthread -ldl -lm -o "$target/calls"
    python3 -m venv "$target/venv"
    CARGO_TARGET_DIR=$target "$target/venv/bin/pip" install --quiet --disable-pip-version-check ./std-adapter/python
    "$target/venv/bin/python" std-adapter/python/tests/speed.py {{rounds}} "C library=$target/calls" "Rust=$target/release/examples/calls"

# What `bcap proxy` adds to a round trip.
[group('measure')]
proxy:
    cargo bench -p bcap-cli --bench proxy

# The time from a halt to the request and to rest, and what the waiting code is told, in 1,000 random trials.
[group('measure')]
halt:
    cargo bench -p bcap-tests --bench halt -- 1000

# Processor time of a client and a gateway under a flood of S_EXECUTING, in 5 s each.
[group('measure')]
flood:
    cargo bench -p bcap-tests --bench flood

# How well streams of Slave Mode keep the cycle of 8 ms next to a busy core: every mode, blocking and tokio, 80 s each.
[group('measure')]
slave cycles="10000":
    cargo bench -p bcap-tests --bench slave -- {{cycles}}

# Virtual controllers, `bcap-fleet`, Mosquitto and a subscriber on this machine: values a second, processor time, memory, latency.
[group('measure')]
fleet controllers="500" values="20" hz="5" seconds="10":
    cargo bench -p bcap-fleet --bench plant -- {{controllers}} {{values}} {{hz}} {{seconds}}

# How soon the standby of a fleet replaces a process that is killed or stopped, and how soon values return after a restart of the broker.
[group('measure')]
takeover count="20":
    TAKEOVERS={{count}} cargo test --release -p bcap-fleet --test all standby::processes_that_are -- --nocapture

# `bcap web` with 1,000 variables at 5 Hz, 10,000 packets/s, in three browsers: processor time, memory, frames a second, what is left out.
[group('measure')]
web-load minutes="2":
    cargo build --release -p bcap-cli
    MINUTES={{minutes}} BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo test -p bcap-web --test all load:: -- --ignored --nocapture

# 1,000 heartbeats of a jog lost at random moments: how soon the robot rests, and whether the arm is free.
[group('measure')]
web-heartbeats robots="2":
    ROBOTS={{robots}} cargo test --release -p bcap-web --test all jog::a_thousand -- --nocapture

# Random programs of motions with each arm: no axis exceeds its speed or leaves its range.
[group('long tests')]
programs count="10000":
    PROGRAMS={{count}} cargo test --release -p bcap-sim --test all robot::random::no_axis

# Random scenarios with 1,000 random calls each, three times: the same records.
[group('long tests')]
scenarios count="100":
    PROGRAMS={{count}} cargo test --release -p bcap-sim --test all determinism::

# Random trials of how programs and `bcap` end while they move a robot, 2,000 with each model; `just endings --only N` repeats one.
[group('long tests')]
endings *args:
    cargo build --release -p bcap-cli
    BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo bench -p bcap-tests --bench endings -- {{args}}

# Pick and place with passes, legs of 5 to 50 mm, speeds of 5 to 100 %, on a busy machine: every cycle arrives.
[group('long tests')]
pick-and-place cycles="100":
    cargo bench -p bcap-tests --bench endings -- pick-and-place {{cycles}}

# A stream in real time with errors, doctor, monitor, fleet and a gateway, on a controller that ends Slave Mode at each refused call.
[group('long tests')]
stream-and-monitors:
    cargo test --release -p bcap-cli --test all monitors:: -- --ignored --nocapture

# Slave Mode in real time through `bcap proxy`, which records: an hour, or `just proxy-slave 1` for a minute. It fails on an underflow.
[group('long tests')]
proxy-slave minutes="60":
    MINUTES={{minutes}} cargo test --release -p bcap-cli --test all proxy_load:: -- --ignored --nocapture

# Values and a file of 256 KiB over a serial cable of 115200 baud that corrupts one byte in 10,000, then 10 s of Slave Mode at 921600.
[group('long tests')]
serial:
    cargo test --release -p bcap-tests --test all serial_cable:: -- --ignored --nocapture --test-threads 1
    cargo test --release -p bcap-cli --test all serial:: -- --ignored --nocapture

# A hundred thousand calls over UDP; one datagram in ten is lost, one in ten duplicated.
[group('long tests')]
lossy calls="100000":
    UDP_CALLS={{calls}} cargo test -p bcap-tests --test all datagrams_are_lost -- --nocapture

# Two hundred clients for a minute, or for `just soak 36000` seconds; half of them misbehave.
[group('long tests')]
soak seconds="60":
    cargo bench -p bcap-tests --bench soak -- --seconds {{seconds}}

# The programs sim, proxy, gateway and fleet, each with good and hostile clients, for 20 minutes: memory, descriptors, output, kept calls.
[group('long tests')]
soak-programs seconds="1200":
    cargo build --release -p bcap-cli -p bcap-fleet
    BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo bench -p bcap-tests --bench soak -- --programs --seconds {{seconds}}

# A fleet whose broker, robots and network keep failing, with 50 commands for each failure: what arrived, was dropped and was executed.
[group('long tests')]
chaos failures="200":
    FAILURES={{failures}} cargo test --release -p bcap-fleet --test all chaos:: -- --nocapture

# All 2^32 values of every length and count, and the edges with 32-bit addresses (needs Debian's gcc-multilib).
[group('long tests')]
lengths:
    cargo test --release -p bcap-testkit --test lengths -- --ignored
    rustup target add i686-unknown-linux-gnu
    cargo test -p bcap-core --lib --target i686-unknown-linux-gnu
    cargo test -p bcap-testkit --test lengths --target i686-unknown-linux-gnu
    cargo test -p bcap-tests --test all --target i686-unknown-linux-gnu -- vectors::

# Compares the lines that docs/spec-notes.md cites with the texts of the specifications: `bcap-rc9.txt` and `rac-rc8.txt` in a folder.
[group('long tests')]
citations folder:
    BCAP_SPECIFICATIONS={{folder}} cargo test -p bcap-tests --test all citations:: -- --ignored

# Prints and parses every 1000th float (`just floats 1`: all of them, half an hour), and the milliseconds of some days.
[group('long tests')]
floats step="1000":
    BCAP_STEP={{step}} cargo test --release -p bcap-core --lib -- --ignored

# Each fuzz target for half a minute, or for `just fuzz 1200` seconds.
[group('fuzz and analyse')]
fuzz seconds="30":
    FUZZ_SECONDS={{seconds}} bash .ci/run fuzz

# How long `bcap fuzz` takes to find each of 35 planted bugs: minutes.
[group('fuzz and analyse')]
planted:
    cargo test --release -p bcap-cli --test all fuzz:: -- --ignored --nocapture

# The corpora of the fuzz targets: `just corpora unpack` writes the archives' inputs to folders, `just corpora pack` the reverse.
[group('fuzz and analyse')]
corpora action:
    cargo run --quiet --locked --manifest-path fuzz/Cargo.toml --no-default-features --example corpora -- {{action}}

# Line coverage of the corpora of a fuzz target: `just coverage text`. Needs nightly's llvm-tools.
[group('fuzz and analyse')]
coverage target:
    bash fuzz/measure-coverage {{target}}

# Mutation tests of a file of the core: `just mutants core/src/bcap/frame.rs`.
[group('fuzz and analyse')]
mutants file shard="0/1":
    cargo install --locked cargo-mutants@27.1.0
    cargo mutants -p bcap-core --file {{file}} --sharding round-robin --shard {{shard}} --timeout 120 --jobs 1 -- --lib

# The core's tests under Miri. All take hours; a filter selects some: `just miri bcap::frame`.
[group('fuzz and analyse')]
miri filter="":
    rustup component add --toolchain nightly miri rust-src
    cargo +nightly miri test -p bcap-core --lib -- {{filter}}

# The tests of the std adapter under AddressSanitizer, and under ThreadSanitizer with an instrumented std.
[group('fuzz and analyse')]
sanitizers:
    rustup component add --toolchain nightly rust-src
    RUSTFLAGS=-Zsanitizer=address CARGO_TARGET_DIR=target/asan \
        cargo +nightly test -p bcap-std --all-features --lib --tests --target x86_64-unknown-linux-gnu
    RUSTFLAGS=-Zsanitizer=thread CARGO_TARGET_DIR=target/tsan \
        cargo +nightly test -Zbuild-std -p bcap-std --all-features --lib --tests --target x86_64-unknown-linux-gnu

# Instructions, against bars, and times of requests through the gateway board in QEMU, compared with a bare echo on it; `bash .ci/run firmware` installs the tools.
[group('board in QEMU')]
board:
    cargo build --release -p bcap-cli
    BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo bench -p bcap-qemu --features qemu --bench gateway

# Flame graph of a request through the gateway board in QEMU, as in docs/performance.md.
[group('board in QEMU')]
flame-board folder="target/flame":
    mkdir -p {{folder}}
    cargo build --release -p bcap-cli
    BCAP_CALLGRIND=$(realpath {{folder}}) BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" \
        cargo bench -p bcap-qemu --features qemu --bench gateway
    c++filt <{{folder}}/board.out | sed -E 's/\[[0-9a-f]{8,16}\]//g; s/<embassy_executor::raw::TaskStorage<.*::__([a-z_]+)_task::.*>>::poll/task \1/' >{{folder}}/board.named
    tests/instructions/flame --root bcap_firmware::executor::run --title "a request, gateway board" /dev/null {{folder}}/board.named >{{folder}}/board.svg

# The gateway board in QEMU for a minute on a link that drops, repeats and delays frames; a seed decides which.
[group('board in QEMU')]
wire seed="1":
    cargo build --quiet --locked --release -p bcap-cli
    WIRE_SECONDS=60 WIRE_SEED={{seed}} BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo test -p bcap-qemu --features qemu wire::

# The gateway board in QEMU with four PLCs while the robot, the link and other clients fail at random: an hour, or `just board-soak 1`.
[group('board in QEMU')]
board-soak minutes="60" seed="1":
    cargo build --release -p bcap-cli
    SOAK_SECONDS=$(({{minutes}} * 60)) SOAK_SEED={{seed}} BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" \
        cargo test -p bcap-qemu --features qemu soak::

# The gateway board in QEMU with invalid leases, floods, slow clients, random frames and bytes, cuts of the link and a robot that is killed: an hour, or `just board-hostile 1`.
[group('board in QEMU')]
board-hostile minutes="60" seed="1":
    cargo build --release -p bcap-cli
    HOSTILE_BARS=yes HOSTILE_SECONDS=$(({{minutes}} * 60)) HOSTILE_SEED={{seed}} BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" \
        cargo test -p bcap-qemu --features qemu hostile::

# A client that sends refused PUTs to the gateway board in QEMU as fast as it can, next to a well-behaved PLC: ten minutes, or `just board-flood 1`.
[group('board in QEMU')]
board-flood minutes="10":
    cargo build --release -p bcap-cli
    FLOOD_SECONDS=$(({{minutes}} * 60)) BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" \
        cargo test -p bcap-qemu --features qemu flood::

# Updates of the gateway board in QEMU with the power cut in each operation of a swap and a roll-back, and in many of a download: 45 minutes.
[group('board in QEMU')]
board-updates:
    cargo build --release -p bcap-cli
    UPDATE_CUTS=all BCAP="${CARGO_TARGET_DIR:-$PWD/target}/release/bcap" cargo test -p bcap-qemu --features qemu update:: -- --nocapture

# Checks a release, as RELEASING.md describes; with `--execute` tags and publishes it: `just release 0.2.0 --execute`.
[group('release')]
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
        cargo semver-checks --baseline-rev "$last" -p bcap-core -p bcap-gateway -p bcap-sim -p bcap-std -p bcap-capture -p bcap-backup -p bcap-stream -p bcap-service -p bcap-live -p bcap-provision -p bcap-web -p bcap-conform -p bcap-embassy -p bcap-board -p bcap-testkit -p bcap-terminal -p bcap-fleet
    fi
    bash .ci/run packages
    packages=(-p bcap-core -p bcap-gateway -p bcap-sim -p bcap-std -p bcap-capture -p bcap-backup -p bcap-stream -p bcap-service -p bcap-live -p bcap-provision -p bcap-web -p bcap-conform -p bcap-embassy -p bcap-board -p bcap-testkit -p bcap-terminal -p bcap-fleet -p bcap-cli)
    case "{{execute}}" in
        --execute)
            cargo publish --locked --no-verify "${packages[@]}"
            git tag --annotate --message 'release {{version}}' 'v{{version}}' ;;
        "") cargo publish --locked --no-verify --dry-run "${packages[@]}" ;;
        *) fail "unknown argument {{execute}}" ;;
    esac

# A Debian package with static binaries, manual pages, completions and units for the gateway and the fleet.
[group('release')]
debian:
    std-adapter/cli/packaging/debian

# The same files as an RPM package; needs rpmbuild.
[group('release')]
rpm:
    std-adapter/cli/packaging/rpm

# Installs the Debian package in an empty root, or in a Debian system in the directory `root`, and uses it there.
[group('release')]
debian-test root="":
    std-adapter/cli/packaging/debian-test {{root}}

# Builds the static binaries in two directories, and compares the bytes.
[group('release')]
reproducible:
    std-adapter/cli/packaging/reproducible
