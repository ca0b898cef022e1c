"""Tune a controller from recordings, and write it into a folder."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from koop_bag.bag.reader import BagReader
from koop_core import whole_file
from koop_core.config.parameter import ConfigError
from koop_identify.model.from_bags import BagTraining, load_bags, train_from_bags
from koop_identify.recording.loaded import Loaded
from koop_identify.recording.samples import recorded_source
from koop_identify.recording.segmentation import BagReading
from koop_identify.settings import READING
from koop_tune.excitation import progress
from koop_tune.excitation.amplitude import Windows
from koop_tune.excitation.design import DESIGN, FLAT, KNOWN
from koop_tune.excitation.progress import ExcitationProgress
from koop_tune.folder import CONTROLLER, FIGURES, MODEL
from koop_tune.result import as_text
from koop_tune.result.summary import summarise, summarise_refusal
from koop_tune.rig.rig_file import STATE, THETA, RigFile
from koop_tune.search.findings import NoOptimum
from koop_tune.search.settings import TUNING, TuningSettings
from koop_tune.search.tune_knobs import tune_knobs


def tune_folders(
    rig: RigFile,
    folders: Sequence[Path],
    out: Path,
    settings: TuningSettings = TUNING,
    note: Path | None = None,
) -> bool:
    """Tune from recordings, write the results and print them; return whether there is an optimum.

    ``folders`` are those of ``koop excite``, or bags. Into ``out`` the parameter file is written
    last; ``note`` is the file that notes where theta was left, for the guard.

    Raises
    ------
    koop_core.errors.InputError
        If there are results already, or the recordings cannot be used.
    """
    began = time.monotonic()
    bags, excitation = find_bags(folders, rig)
    rig = excitation.narrow(rig)
    if (out / CONTROLLER).exists():
        raise ConfigError(f"{out / CONTROLLER} exists already: choose another --out")
    loaded, reading = load_since(bags, rig, excitation)
    if loaded.x.shape[0] != len(rig.names):
        raise ConfigError(
            f"{bags[0]}: {reading.measured} has {loaded.x.shape[0]} channels, the rig file "
            f"{len(rig.names)}"
        )
    out.mkdir(parents=True, exist_ok=True)
    lines = {line.knob: rig.u(line.theta) for line in excitation.sections}
    try:
        tuned = tune_knobs(
            loaded, rig, lines, excitation.arrays(rig), BagTraining(reading), excitation.amplitude,
            settings, lambda step: print(f"finding {step}", flush=True), excitation.safe,
        )  # fmt: skip
    except NoOptimum as refusal:
        result = summarise_refusal(refusal)
        whole_file.write_json(out / FIGURES, result)
        table = as_text.as_table(result, rig.knob_names)
        print(f"{table}\n\nno controller ({refusal.kind}): {refusal}")
        return False
    model, cost = None, tuned.tuning.chosen.maps.cost
    if cost.training is not None:
        model = out / MODEL
        if rig.count == 1:
            train_from_bags(bags, cost.training).save(model)
        elif cost.model is not None:  # learned from the section
            cost.model.save(model)
    result = summarise(tuned, model)
    whole_file.write_json(out / FIGURES, result)
    whole_file.write_text(out / CONTROLLER, as_text.as_parameters(tuned, model, note))
    print(f"{as_text.as_table(result, rig.knob_names)}\n\n{as_text.as_words(tuned)}")
    print(f"\ntuned in {time.monotonic() - began:.0f} s; written to {out}")
    return True


def reading_of(bag: Path, rig: RigFile, windows: Windows | None = None) -> BagReading:
    """Return the topics and time step with which recordings of a rig are read.

    The lifter's and the controller's topics are read where the bag has them, else the rig's own.
    Where messages were lost, half a period of the slowest oscillation that reacts is bridged.

    Raises
    ------
    koop_bag.errors.BagError
        If the bag cannot be read.
    """
    with BagReader(bag) as reader:
        topics = {topic.name for topic in reader.topics if topic.count}
    measured = recorded_source(f"{STATE}:x" if STATE in topics else rig.measured)
    told = [recorded_source(f"{THETA}:{','.join(f'theta[{i}]' for i in range(rig.count))}")]
    commands = told if THETA in topics else rig.command_sources
    bridged = 0.5 * windows.seconds / DESIGN.window if windows else 0.0
    gap = bridged if bridged > READING.gaps * rig.dt else None
    return BagReading(measured, tuple(commands), rig.dt, gap)


def load_since(
    bags: Sequence[Path], rig: RigFile, excitation: ExcitationProgress
) -> tuple[Loaded, BagReading]:
    """Load recordings of a rig from where on the holds of its excitation count.

    All counts where nothing has reacted yet.

    Raises
    ------
    koop_core.errors.InputError
        If they cannot be used.
    """
    loaded, reading = load_bags(bags, reading_of(bags[0], rig, excitation.windows))
    since = 0.0 if excitation.amplitude is None else excitation.since
    return loaded.after(int(since / rig.dt)), reading


def list_bags(folder: Path, rig: RigFile, state: ExcitationProgress) -> list[Path]:
    """Return the recordings of an excitation; of a part that was killed early, none.

    Raises
    ------
    koop_bag.errors.BagError
        If a bag cannot be read.
    """
    bags = []
    for bag in (folder / part / "bag" for part in state.parts):
        if bag.is_dir():
            with BagReader(bag) as reader:
                topics = {topic.name for topic in reader.topics if topic.count}
            commands = {source.topic for source in rig.command_sources}
            if topics & {STATE, rig.measured_source.topic} and topics & {THETA, *commands}:
                bags.append(bag)
    return bags


def find_bags(folders: Sequence[Path], rig: RigFile) -> tuple[list[Path], ExcitationProgress]:
    """Return the bags of folders, and the progress of the excitation; a new one without any.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If there are none.
    """
    bags: list[Path] = []
    excitation = ExcitationProgress()
    for folder in folders:
        if not folder.exists():
            raise ConfigError(f"{folder}: does not exist")
        state = progress.load(rig, folder) if folder.is_dir() else None
        if state is None:
            bags.append(folder / "bag" if (folder / "bag").is_dir() else folder)
            continue
        excitation = state
        bags += list_bags(folder, rig, state)
        if state.ended not in (KNOWN, FLAT):
            print(f"note: {folder}: the excitation is not finished")
            if len(state.sections) < rig.count:  # of the other knobs nothing is known
                state.sections = []
    if not bags:
        raise ConfigError(f"{folders[0]}: no recording found: run 'koop excite' first")
    return bags, excitation
