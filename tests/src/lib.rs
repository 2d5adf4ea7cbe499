//! What crosses the crates of the b-CAP stack: generators, an independent decoder, vectors and counters for the tests.
