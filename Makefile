# Every target does all that it needs from a bare checkout: Python >= 3.11 with venv, and make.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
TABLES := table1 table2
FIGURES := fig01 fig02 fig03 fig04 fig05 fig06 fig07 fig08 fig09 fig10
RANGES := range_constant range_disturbed
CHARTS := chart_b_d chart_b_a
FLOWS := $(notdir $(basename $(wildcard configs/flows/*.yaml)))
GALLERY := oscillating_mass sleigh_with_rotor sleigh_in_a_valley roller_racer suslov chaplygin_top appell_hamel parallel_velocities rotators thermostat nose_hoover speed_in_space switched_sleigh rubber_ball rubber_disk snakeboard two_wheeled_carriage pursuit two_particles rattleback celtic_stone celtic_chart discrete_lorenz
PAPER_FIGURES := paper_diagram paper_chart paper_sleigh
EFFECTS := table1 fig01 range_constant table2 fig06 range_disturbed unforced sleigh

# Tests and studies start hundreds of processes; none need compile the sources of the package and of the tests anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install atlas $(TABLES) $(FIGURES) $(RANGES) $(CHARTS) unforced governor basins branches reversal manifolds lorenz_manifold flows gallery $(addprefix gallery_,$(GALLERY)) paper paper-figures $(PAPER_FIGURES) gpu scale effects startup first_answer reference newcomer claims docs release-check test browser check_types check_tests slow hard clean

install: $(INSTALLED)

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "jaxnh needs Python 3.11 or newer; name one by PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(RUN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev,dask,explore]'
	touch $@

$(TABLES): $(INSTALLED)
	$(RUN)/python -m jaxnh.sweep configs/$@.yaml --fresh

$(FIGURES) $(RANGES) $(CHARTS) unforced governor basins branches reversal manifolds lorenz_manifold: $(INSTALLED)
	$(RUN)/python -m jaxnh.sweep configs/$@.yaml --fresh
	$(RUN)/python -m jaxnh.plot results/$@.h5

# An atlas of a plane of two parameters: of the particle, or of another CONFIG.
CONFIG ?= configs/atlas_particle.yaml
atlas: $(INSTALLED)
	$(RUN)/python -m jaxnh.sweep $(CONFIG) --fresh
	$(RUN)/python -m jaxnh.plot results/$(basename $(notdir $(CONFIG))).h5

# Known flows (configs/flows), and their pictures.
flows: $(INSTALLED)
	failed=; for flow in $(FLOWS); do \
	  $(RUN)/python -m jaxnh.sweep configs/flows/$$flow.yaml --fresh && $(RUN)/python -m jaxnh.plot results/$$flow.h5 \
	    || failed="$$failed $$flow"; \
	done; \
	if [ "$$failed" ]; then echo "failed:$$failed"; exit 1; fi

# Nonholonomic systems of the literature (configs/nonholonomic), and the pictures of docs/gallery.md.
gallery: $(addprefix gallery_,$(GALLERY))

gallery_oscillating_mass: PICTURE := --size 130x120 --coordinates along
gallery_parallel_velocities: PICTURE := --coordinates x1,y1
gallery_sleigh_with_rotor: PICTURE := --coordinates along,turn
gallery_roller_racer: PICTURE := --size 130x120 --coordinates along
gallery_chaplygin_top: PICTURE := --size 130x120 --coordinates w3
gallery_nose_hoover: PICTURE := --size 130x120 --coordinates p
gallery_speed_in_space: PICTURE := --size 130x120
gallery_switched_sleigh: PICTURE := --size 130x120 --coordinates turn
gallery_rubber_ball gallery_rubber_disk: PICTURE := --size 130x90 --coordinates w3
gallery_snakeboard: PICTURE := --size 130x90 --coordinates along
gallery_two_wheeled_carriage: PICTURE := --size 130x120 --coordinates along
gallery_pursuit: PICTURE := --size 130x125 --coordinates x
gallery_rattleback: PICTURE := --size 150x180 --coordinates g1,w3
gallery_celtic_stone: PICTURE := --size 130x90 --coordinates g2
gallery_discrete_lorenz: PICTURE := --size 130x90 --coordinates g2
$(addprefix gallery_,$(GALLERY)): gallery_%: $(INSTALLED)
	$(RUN)/python -m jaxnh.sweep configs/nonholonomic/$*.yaml --output results/$@.h5 --fresh
	$(RUN)/python -m jaxnh.plot results/$@.h5 $(or $(PICTURE),--size 130x90)

# Both tables and all ten figures anew. Three at a time: each run uses all cores, but not while it imports, reads or draws.
paper: $(INSTALLED)
	$(MAKE) --jobs=3 $(if $(filter output-sync,$(.FEATURES)),--output-sync=target) $(TABLES) $(FIGURES)

# The figures of paper/paper.md, in its folder.
paper-figures: $(PAPER_FIGURES)

paper_diagram: CONFIG := configs/fig04.yaml title='Bifurcation diagram at constant speed'
paper_chart: CONFIG := configs/chart_b_d.yaml sweep.b.count=384 sweep.d.count=256
paper_sleigh: CONFIG := configs/nonholonomic/oscillating_mass.yaml
paper_chart: PICTURE := --size 160x140
paper_sleigh: PICTURE := --size 130x90 --coordinates along
$(PAPER_FIGURES): paper_%: $(INSTALLED)
	$(RUN)/python -m jaxnh.sweep $(CONFIG) --output results/$@.h5 --fresh
	$(RUN)/python -m jaxnh.plot results/$@.h5 --output paper/$*.png $(or $(PICTURE),--size 130x90)

# Maps, charts, basins and orbits on a graphics card, or in small on a CPU (SMALL=--small); writes results/gpu.md.
gpu: $(INSTALLED)
	$(RUN)/python -m sweeps.timing.gpu $(SMALL)

# What a chart of a billion lanes takes beside computing: workers that sleep, merges of real files; writes results/scale.md.
scale: $(INSTALLED)
	$(RUN)/python -m sweeps.timing.scale

# What each effect and analysis costs; writes results/effects.md.
effects: $(INSTALLED)
	for scene in $(EFFECTS); do $(RUN)/python -m jaxnh.cost configs/$$scene.yaml --effects --repeats 11 || exit; done
	$(RUN)/python -m sweeps.timing.effects

# Time from command to result, in its parts; writes results/startup.md. On a machine that does nothing else.
startup: $(INSTALLED)
	$(RUN)/python -m sweeps.timing.startup

# How soon strangers' flows are answered, and how rightly (pip install dysts); writes results/first_answer.md.
first_answer: $(INSTALLED)
	$(RUN)/python -m sweeps.timing.first_answer

# The reference table: spectra of all flows of dysts (pip install dysts) and of maps; writes results/reference_flows.h5
# and docs/reference/flows.md. An hour, resumable.
reference: $(INSTALLED)
	$(RUN)/python -m sweeps.studies.reference_flows --longer 30

# What the README, the how-to pages and three strangers' flows have, run as it stands there, against results/newcomer.md.
newcomer: $(INSTALLED)
	$(RUN)/python -m sweeps.checks.newcomer

# What every quantitative claim rests on, checked; writes results/claims.md. Times nothing, computes nothing anew.
claims: $(INSTALLED)
	$(RUN)/python -m sweeps.checks.claims

# The documentation, in docs/_build/html: its notebooks are run, and a warning or a broken link in it is an error.
DOCS_INSTALLED := $(VENV)/.docs_installed
docs: $(DOCS_INSTALLED)
	$(RUN)/python -m sphinx --builder html --fail-on-warning --keep-going --nitpicky docs docs/_build/html

$(DOCS_INSTALLED): $(INSTALLED)
	$(RUN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	touch $@

# Wheel and sdist, installed and used where the repository is not; also with the newest versions and the newest Python of
# this machine, or one named by NEWEST=PYTHON.
NEWEST ?= $(lastword $(wildcard $(foreach minor,11 12 13 14 15,$(HOME)/.pyenv/versions/3.$(minor).*/bin/python /usr/bin/python3.$(minor) /usr/local/bin/python3.$(minor))))
release-check: $(INSTALLED)
	$(RUN)/python -m sweeps.checks.release_check --newest '$(NEWEST)'

# Style, layers, names, types and all tests but those marked slow. Types, and names in strings, are checked beside the tests, by
# one core for a minute.
test: $(INSTALLED)
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/lint-imports --no-cache
	$(RUN)/python -m sweeps.checks.names
	$(MAKE) --jobs=2 --keep-going check_types check_tests

check_types: $(INSTALLED)
	$(RUN)/python -m sweeps.checks.quoted_names
	$(RUN)/basedpyright --warnings

# A browser for the tests of the explorer's page, where tests run by themselves (CI is set, as root, on Debian's like) and
# there is none; elsewhere nothing is installed, and they are skipped.
BROWSERS := chromium chromium-browser google-chrome
browser:
	@if [ -z "$$(command -v $(BROWSERS))" ] && [ "$$CI" ] && [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  { timeout 120 apt-get update && timeout 300 apt-get install --yes --no-install-recommends chromium; } >/dev/null 2>&1 \
	    || echo "no Chromium could be installed: tests of the explorer in a browser are skipped"; \
	fi

check_tests: $(INSTALLED) browser
	$(RUN)/pytest --numprocesses 2 --dist worksteal --durations 20

# The tests marked slow, and no others; of them the k-th of n parts of even length by PART=k/n.
slow: $(INSTALLED)
	$(RUN)/pytest --numprocesses 2 --dist worksteal -m slow $(if $(PART),--part $(PART),--keep-seconds)

# The hard cases at full size, three hours of one core, or of one CASE, or the k-th of n parts by PART=k/n; writes
# results/hard.md and its pictures.
hard: $(INSTALLED)
	$(RUN)/pytest --numprocesses 2 --dist worksteal -m "" --hard --page results/hard.md $(if $(CASE),--case '$(CASE)') $(if $(PART),--part $(PART)) tests/hard

clean:
	rm -rf $(VENV) docs/_build .pytest_cache .ruff_cache
