# Everything a person does with a clone. `make demo` and `make test` do their own set-up.
.PHONY: help setup demo window web web-test test lint deny fuzz

help:
	@echo 'make demo   real server, real client, loopback: pictures in target/demo  (SCENE=… LIGHTS=… CAMERA=… ANIMATION=… SIZE=… FRAMES=…)'
	@echo 'make window the same in a window, to walk around in'
	@echo 'make web    the page for browsers, into target/web/page; wants: rustup target add wasm32-unknown-unknown'
	@echo 'make web-test  the page in Chromium, on a server; wants node, npm, chromium, make web, and the programs of make test'
	@echo 'make test   the whole suite; wants GNOMON_SCENES=DIR, the folder with the real scenes'
	@echo 'make lint   fmt and clippy, warnings denied; import circles, long files, long lines'
	@echo 'make deny   licences, bans, sources and known holes of every dependency'
	@echo 'make fuzz   every fuzz target for SECONDS=60, on all cores; wants a C++ compiler'

setup:
	@deploy/setup

# Pictures need no window, and the window is a third of what there is to compile.
demo: setup
	cargo build --release --locked -p gnomon-server -p gnomon-client --no-default-features
	deploy/demo

window: setup
	cargo build --release --locked -p gnomon-server -p gnomon-client
	target/release/gnomon-client --demo

web:
	client/web/build

web-test:
	cd tests/web && npm install --no-package-lock --no-audit --no-fund --silent && npm test

# The ray-query back end wants an adapter that few machines have, so a driver is laid beside the system for its tests.
test:
	@deploy/setup tests
	@driver=$$(deploy/ray-query-driver) || echo 'make test: THE RAY-QUERY BACK END IS NOT TESTED, unless the machine has ray queries of its own: see above' >&2; \
	[ -z "$$driver" ] || export GNOMON_RAY_QUERY_DRIVER="$$driver"; \
	echo cargo test --workspace --locked; cargo test --workspace --locked

lint:
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked -- -D warnings
	cargo clippy -p gnomon-client --no-default-features --locked -- -D warnings
	cargo test --locked --quiet -p gnomon-lint
	@if [ -d "$$(rustc --print target-libdir --target wasm32-unknown-unknown)" ]; then \
	  cargo check --locked --target wasm32-unknown-unknown -p gnomon-client-core; \
	else echo 'make lint: the core is not checked for browsers: rustup target add wasm32-unknown-unknown' >&2; fi

deny:
	cargo deny --locked check bans licenses sources
	@.ci/advisories

SECONDS ?= 60
fuzz:
	GNOMON_FUZZ_SEEDS=$(CURDIR)/target/fuzz-run/seeds cargo test -p gnomon-protocol -p gnomon-scene --test fuzz_smoke
	GNOMON_FUZZ_SEEDS=$(CURDIR)/target/fuzz-run/seeds cargo test -p gnomon-server --lib fuzzing
	GNOMON_FUZZ_SEEDS=$(CURDIR)/target/fuzz-run/seeds cargo test -p gnomon-client --lib fuzzing
	tests/fuzz/build target/fuzz-run --features server,client
	target/fuzz-run/run $(SECONDS) target/fuzz-run/out
