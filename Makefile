# insitu: `make demo` and `make test` set up what is missing, then run. Only Rust must be there before.

# OpenCV and its bindings' needs; Mesa's lavapipe is a Vulkan device for machines without a GPU.
PACKAGES := libopencv-dev libopencv-contrib-dev clang libclang-dev pkg-config mesa-vulkan-drivers
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo -E)
INSITU := target/release/insitu

.PHONY: demo test bench validate build setup

demo: build
	$(INSITU) run pipeline.toml
	@echo
	@echo "augmented photograph: $(CURDIR)/work/composite/augmented.png"
	@echo "report:               $(CURDIR)/work/evaluate/report.html"

test: build
	cargo test --release

bench: build
	$(INSITU) bench pipeline.toml

validate: build
	$(INSITU) validate fixtures

build: setup
	cargo build --release

setup:
	@missing=$$(for p in $(PACKAGES); do dpkg -s $$p >/dev/null 2>&1 || echo $$p; done); \
	if [ -n "$$missing" ]; then \
		command -v apt-get >/dev/null || { echo "please install:" $$missing; exit 1; }; \
		echo "installing:" $$missing; \
		$(SUDO) apt-get update -q && \
		DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -y -q --no-install-recommends $$missing; \
	fi
	@command -v cargo >/dev/null || { echo "please install Rust: https://rustup.rs"; exit 1; }
