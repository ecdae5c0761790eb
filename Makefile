# The two commands of the README: make demo, make test. Each makes the environment it needs.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
OUT ?= out/demo
WORKERS ?= 2
# A test that kills its worker ends the run: pytest-xdist hangs where it restarts one.
TOGETHER := -n $(WORKERS) --dist loadfile --no-loadscope-reorder --max-worker-restart=0
OFFICIAL ?= --seeds 1 --data tanks emps --kinds arx linear piecewise grey_box symbolic narx gp state_nn nn
GAP ?= --quick --limit 10 --methods discover sindy gp --out out/gap_quick
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Where it is set, every child process compiles every module anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo fmus gates test lint bench bench-ablation bench-bands bench-gap bench-learned bench-others scoreboard clean

help:
	@echo "make demo   the whole main job on the shipped recordings, into $(OUT)"
	@echo "make fmus   build the FMUs of fmus/ and check them; one of them: make fmus FMUS=cehA;"
	@echo "            for every machine: make fmus PLATFORM=all"
	@echo "make gates  the same by version and kind, through every program that judges FMUs, into fmus/GATES.md"
	@echo "make test   the tests"
	@echo "make lint   style"
	@echo "make bench  slow proofs, then speed, as ratios"
	@echo "make bench-bands  whether bands cover what sensors read, and are doubted where something is missing, on 80 cases;"
	@echo "                in pieces: make bench-bands BANDS='--cases 4 --kind right'"
	@echo "make bench-gap  which hidden effects the gap workflow finds, beside the baselines, on 10 short cases;"
	@echo "                all of them: make bench-gap GAP='--seeds fresh --out out/gap_fresh'"
	@echo "make bench-learned  every kind of learned model by its defaults on recordings made by others"
	@echo "make bench-ablation  what each default of the learned kinds brings, one less at a time, into docs/scoreboard.md"
	@echo "make bench-others  SysIdentPy and deepSI by their own defaults on the same recordings, into docs/scoreboard.md"
	@echo "make scoreboard  docs/scoreboard.md: learned models and identified physics on official benchmarks"

# torch==2.13.0 comes from constraints.txt
$(VENV)/.run: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[learned]"
	@touch $@

$(VENV)/.dev: $(VENV)/.run
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[learned,dev]"
	@touch $@

# sysidentpy wants an older numpy than constraints.txt has: an environment of its own
$(VENV)-bench/.others: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)-bench
	grep -v '^numpy==' constraints.txt > $(VENV)-bench/constraints.txt
	$(VENV)-bench/bin/python -m pip install --quiet -c $(VENV)-bench/constraints.txt -e ".[learned,bench]"
	@touch $@

demo: $(VENV)/.run
	$(BIN)/python -m hydrotwin demo --out $(OUT)

fmus: $(VENV)/.run
	$(BIN)/python -m fmus.make $(FMUS) $(addprefix --platform ,$(PLATFORM))

gates: $(VENV)/.dev
	$(BIN)/python -m fmus.gates --write $(FMUS)

test: $(VENV)/.dev
	$(BIN)/python -m pytest -q -m "not proof" $(TOGETHER) --durations=15

lint: $(VENV)/.dev
	$(BIN)/ruff check .

bench: $(VENV)/.dev
	$(BIN)/python -m pytest -q -m proof $(TOGETHER)
	$(BIN)/python benchmarks/run.py

bench-gap: $(VENV)/.dev
	$(BIN)/python -m benchmarks.gap --processes $(WORKERS) $(GAP)

bench-bands: $(VENV)/.dev
	$(BIN)/python -m benchmarks.comparison.band_coverage $(BANDS)

bench-learned: $(VENV)/.dev
	$(BIN)/python -m benchmarks.learned.foreign $(LEARNED)

bench-ablation: $(VENV)/.dev
	$(BIN)/python -m benchmarks.learned.ablation --scoreboard docs/scoreboard.md $(ABLATION)

bench-others: $(VENV)-bench/.others
	$(VENV)-bench/bin/python -m benchmarks.learned.others --scoreboard docs/scoreboard.md $(OTHERS)

scoreboard: $(VENV)/.dev
	$(BIN)/python -m benchmarks.learned.foreign $(OFFICIAL) --scoreboard docs/scoreboard.md
	$(BIN)/python -m benchmarks.learned.physical --scoreboard docs/scoreboard.md

clean:
	rm -rf out build dist .pytest_cache .ruff_cache .import_linter_cache
