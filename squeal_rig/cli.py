"""The command `squeal-rig`: argument parsing only; what each command does is imported when it runs."""

import math
import sys
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from squeal_rig.configuration.new_files import close_to_strangers
from squeal_rig.errors import ConfigurationError, SquealRigError, printable
from squeal_rig.report.terminal import PlainConsole

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # units stand in brackets, which are no markup
    help="A virtual test rig for brake squeal: run it, record it, analyse it.",
)
console = PlainConsole()

BagArgument = Annotated[Path, typer.Argument(help="A bag: its folder or its .mcap file.", metavar="BAG")]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite a file that is there.")]
InstrumentsOption = Annotated[
    Optional[str],
    typer.Option(help="Data sheets: ideal, typical, poor, or a YAML file; those of the parameters by default."),
]
NO_ROS = "ROS 2 is not installed here: pip install 'squeal_rig[jazzy]', or source a ROS 2 Jazzy installation"


def _finite(value: float | None) -> float | None:
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} s is not finite")
    return value


def _need_page() -> None:
    from importlib.util import find_spec

    if find_spec("aiohttp") is None:
        raise SquealRigError("the page needs aiohttp: pip install 'squeal_rig[page]'")


def _new_bag(given: Path | None) -> Path:
    from squeal_rig.recording.writer import new_directory

    return given or new_directory()


def _data_sheets(given: str | None) -> str | None:
    """Data sheets as nodes find them wherever they run; a wrong file is refused before anything starts."""
    from squeal_rig.instruments.data_sheets import data_sheet_path, load_data_sheets

    if given is None:
        return None
    load_data_sheets(given)
    return str(path.absolute()) if (path := data_sheet_path(given)) == Path(given) else given


@app.command()
def run(
    config: Annotated[Optional[Path], typer.Option(help="Node parameters; the package's rig.yaml by default.")] = None,
    bag: Annotated[Optional[Path], typer.Option(help="Bag to write; bags/<UTC stamp> by default.")] = None,
    record: Annotated[bool, typer.Option(help="Record a bag.")] = True,
    plan: Annotated[Optional[Path], typer.Option(help="Plan to run; without one the rig runs until Ctrl-C.")] = None,
    duration: Annotated[
        Optional[float], typer.Option(help="End a run that has no plan after so long [s].", min=0.0, callback=_finite)
    ] = None,
    instruments: InstrumentsOption = None,
    page: Annotated[bool, typer.Option("--page", help="Serve the operator's page too.")] = False,
    control: Annotated[bool, typer.Option("--control", help="Let the page operate the rig.")] = False,
) -> None:
    """Start the nodes as processes, show the rig live, end cleanly on Ctrl-C."""
    from squeal_rig.catalogue.checking import check_file
    from squeal_rig.configuration.files import config_directory
    from squeal_rig.experiments.plan import load_plan
    from squeal_rig.graph import signals
    from squeal_rig.session.run import SessionOptions, SignalWatch, run_session

    parameters = config or config_directory() / "rig.yaml"
    check_file(parameters)
    chosen_plan = load_plan(plan) if plan is not None else None
    if page:
        _need_page()
    elif control:
        raise ConfigurationError("--control lets the page operate the rig: give --page too")
    served = None if not page else ["-p", "control:=true"] if control else []
    sheets = _data_sheets(instruments)
    options = SessionOptions(
        parameters, _new_bag(bag) if record else None, chosen_plan, duration, instruments=sheets, page=served
    )
    try:
        result = run_session(options, console, SignalWatch())
    finally:
        signals.ignore()  # what is left is to end
    failed = {name: code for name, code in result.exit_codes.items() if code != 0}
    if options.bag is not None:
        console.print(f"bag: {options.bag}")
    if failed:
        raise SquealRigError(f"nodes that did not end well, by exit code: {failed}")


@app.command("page")
def operators_page(
    bag: Annotated[
        Optional[Path],
        typer.Argument(help="A bag to show, read-only; the live rig where none is given.", metavar="[BAG]"),
    ] = None,
    config: Annotated[Optional[Path], typer.Option(help="Node parameters; the package's rig.yaml by default.")] = None,
    address: Annotated[Optional[str], typer.Option(help="Address to listen on; 127.0.0.1 by default.")] = None,
    port: Annotated[Optional[int], typer.Option(help="Port to listen on; 8460 by default.", min=0, max=65535)] = None,
    token_file: Annotated[
        Optional[Path], typer.Option(help="File with the token that every request must show.")
    ] = None,
    hosts: Annotated[
        Optional[list[str]],
        typer.Option("--host", help="Name, besides the address, under which browsers may reach it; may be repeated."),
    ] = None,
    control: Annotated[bool, typer.Option("--control", help="Let the page operate the rig.")] = False,
) -> None:
    """The operator's page of the rig that runs on this ROS domain, or of a bag."""
    from squeal_rig.catalogue.checking import check_file, node_settings
    from squeal_rig.configuration.files import config_directory

    _need_page()
    parameters = config or config_directory() / "rig.yaml"
    check_file(parameters)
    given: dict[str, Any] = {"address": address, "port": port, "hosts": hosts or None, "control": control or None}
    given["token_file"] = str(token_file) if token_file is not None else None
    chosen = {name: value for name, value in given.items() if value is not None}
    if bag is not None:
        from squeal_rig.page.serve_bag import serve_bag
        from squeal_rig.page.settings import PageSettings

        serve_bag(bag, PageSettings.from_mapping(chosen, node_settings(parameters, "page", PageSettings)), console)
        return
    from squeal_rig.session.page import run_page

    code = run_page(parameters, chosen)
    raise typer.Exit(code)


@app.command()
def demo(
    bag: Annotated[Optional[Path], typer.Option(help="Bag to write; bags/<UTC stamp> by default.")] = None,
    instruments: InstrumentsOption = None,
) -> None:
    """From quiet sliding into squeal: a scripted run of 23 s, its bag, its replay, its picture."""
    from squeal_rig.graph import signals
    from squeal_rig.session.demo import run_demo

    sheets = _data_sheets(instruments)
    try:
        code = run_demo(_new_bag(bag), console, sheets)
    finally:
        signals.ignore()  # what is left is to end
    raise typer.Exit(code)


@app.command()
def analyse(
    bag: BagArgument,
    picture: Annotated[
        Optional[Path], typer.Option(help="PNG, PDF or SVG to write; report.png in the bag's folder by default.")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Friction, squeal frequency against the eigenvalues, time off the belt: a table and a PNG."""
    from squeal_rig.analysis.segments import analyse_bag
    from squeal_rig.report.run_figure import check_picture, draw_run
    from squeal_rig.report.tables import SegmentTable, zone_sentences

    target = picture or (bag if bag.is_dir() else bag.parent) / "report.png"
    check_picture(target, force)
    analysis = analyse_bag(bag)
    console.print(SegmentTable(analysis))
    for sentence in zone_sentences(analysis):
        console.print(sentence)
    if analysis.lost_samples:
        console.print(f"lost samples: {analysis.lost_samples}")
    if analysis.restarts:
        console.print(f"restarts of the rig: {analysis.restarts}; the parts are joined end to end")
    draw_run(analysis, target, force)
    console.print(f"picture: {target}")


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for the page, the pictures and the tables.")] = Path("reproduction"),
    preset: Annotated[str, typer.Option(help="Preset to compute from.")] = "yavuz_sen_2023",
) -> None:
    """Every result of the paper from the preset, beside the printed numbers: a page, pictures, tables."""
    from squeal_rig.studies.reproduction.run import run_reproduction

    run_reproduction(preset, out, console)


PresetOption = Annotated[str, typer.Option(help="Preset to begin from.")]
SetOption = Annotated[
    Optional[list[str]], typer.Option("--set", help="Parameter of the rig, name=value; several may follow.")
]
MoreSettings = Annotated[Optional[list[str]], typer.Argument(metavar="[NAME=VALUE]...", help="More settings.")]
FolderOption = Annotated[Path, typer.Option(help="New folder for the page, the pictures and the tables.")]
FolderForceOption = Annotated[bool, typer.Option("--force", help="Overwrite files that are in the folder.")]


@app.command()
def cycles(
    out: FolderOption,
    preset: PresetOption = "yavuz_sen_2023",
    setting: SetOption = None,
    more: MoreSettings = None,
    over: Annotated[
        str, typer.Option(help="Parameter along which they are followed: mu0, pad_stiffness, any other number.")
    ] = "mu0",
    within: Annotated[
        Optional[str], typer.Option(help="Range of that parameter, low:high.", metavar="LOW:HIGH")
    ] = None,
    force: FolderForceOption = False,
) -> None:
    """Squeal cycles and separatrix of a rig along one of its parameters: branch, folds, multipliers, contact force."""
    from squeal_rig.configuration.arguments import span
    from squeal_rig.model.parameters import RigParameters
    from squeal_rig.studies.hard_squeal.pages import run_cycles

    rig = RigParameters.chosen(preset, [*(setting or ()), *(more or ())])
    run_cycles(rig, over, span(within, over) if within else None, out, force, console)


@app.command("map")
def zone_map(
    out: FolderOption,
    preset: PresetOption = "yavuz_sen_2023",
    setting: SetOption = None,
    more: MoreSettings = None,
    preload: Annotated[str, typer.Option(help="Range of the preload [N], low:high.", metavar="LOW:HIGH")] = "10:300",
    speed: Annotated[str, typer.Option(help="Range of the belt speed [m/s], low:high.", metavar="LOW:HIGH")] = "1:4",
    force: FolderForceOption = False,
) -> None:
    """Where a rig is quiet, where an impact makes it squeal, where it squeals by itself: over preload and speed."""
    from squeal_rig.configuration.arguments import span
    from squeal_rig.model.parameters import RigParameters
    from squeal_rig.studies.hard_squeal.pages import run_map

    rig = RigParameters.chosen(preset, [*(setting or ()), *(more or ())])
    run_map(rig, span(preload, "preload", "N"), span(speed, "belt speed", "m/s"), out, force, console)


study_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Studies of the rig as a measuring device.")
app.add_typer(study_app, name="study")


@study_app.command("friction-bias")
def friction_bias(
    out: FolderOption,
    preset: PresetOption = "yavuz_sen_2023",
    instruments: Annotated[
        str, typer.Option(help="Data sheets: a file of config/instruments/ without .yaml, or a path.")
    ] = "typical",
    force: FolderForceOption = False,
) -> None:
    """What each error of the instruments does to mu: every estimator, in sliding and in squeal, over averaging time."""
    from squeal_rig.model.parameters import RigParameters
    from squeal_rig.studies.friction_bias.pages import run_friction_bias

    run_friction_bias(RigParameters.chosen(preset, []), instruments, out, force, console)


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="Parameters, a plan, a campaign, data sheets, ...", metavar="FILE")],
) -> None:
    """Check a YAML file of ours; exit code 2 and one sentence when something is wrong with it."""
    from squeal_rig.catalogue.checking import check_file

    console.print(f"{file}: {check_file(file)}, all in order")


@app.command("warm-up")
def warm_up() -> None:
    """Compile the model now instead of at its first use: after an installation, in a container image."""
    import time

    from squeal_rig.instruments.warm_up import warm_up as compile_everything

    console.print("compiling the model, once: one to two minutes")
    begin = time.monotonic()
    compile_everything()
    console.print(f"the model is compiled: {time.monotonic() - begin:.1f} s")


bag_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Look into bags, check them, save them, cut, merge, export."
)
app.add_typer(bag_app, name="bag")

OutArgument = Annotated[Path, typer.Argument(help="New folder for the bag that is written.", metavar="OUT_DIR")]
TopicsOption = Annotated[
    Optional[list[str]], typer.Option("--topic", help="Topic or pattern; may be given several times.")
]


@app.command()
def calibrate(
    targets: Annotated[Path, typer.Argument(help="A calibration, or a file of targets.", metavar="TARGETS")],
    free: Annotated[
        Optional[str],
        typer.Option(help="Free parameters, by commas: name or name=lower:upper."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the search.", min=0)] = 1,
    starts: Annotated[int, typer.Option(help="Independent searches.", min=1)] = 8,
    generations: Annotated[int, typer.Option(help="Longest search, in generations.", min=1)] = 600,
    out: Annotated[Path, typer.Option(help="Preset to write.")] = Path("calibrated.yaml"),
) -> None:
    """Find a rig that meets thresholds, frequencies, contact loss or jumps; leaves a preset with its residuals."""
    from squeal_rig.studies.inverse.calibrate import Effort, run_calibration

    run_calibration(targets, free.split(",") if free else [], Effort(seed, starts, generations), out, console)


campaign_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Measure a matrix of operating points, go on with it, report it."
)
app.add_typer(campaign_app, name="campaign")
CampaignFolder = Annotated[Path, typer.Argument(help="Folder of a campaign.", metavar="DIR")]
WorkersOption = Annotated[
    Optional[int], typer.Option(help="Processes that measure; chosen by the size of the campaign by default.", min=0)
]
SchedulerOption = Annotated[str, typer.Option(help="Address of a Dask scheduler, tcp://host:8786.")]


@campaign_app.command("run")
def campaign_run(
    plan: Annotated[Path, typer.Argument(help="Plan of the campaign, as config/campaigns/smoke.yaml.", metavar="PLAN")],
    out: Annotated[Path, typer.Option(help="New folder for the plan, the journal, the tables and the report.")],
    live: Annotated[bool, typer.Option("--live", help="On the ROS graph, through the rig's node.")] = False,
    config: Annotated[
        Optional[Path], typer.Option(help="Live: node parameters; the package's rig.yaml by default.")
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = "",
    chunk: Annotated[Optional[int], typer.Option(help="Points handed out at once.", min=1)] = None,
) -> None:
    """Measure every point of a plan, by the engine alone or live, and write a report."""
    from squeal_rig.experiments.campaign.plans import load_campaign
    from squeal_rig.experiments.campaign.running import start

    campaign, parameters = load_campaign(plan), ""
    if live:
        from squeal_rig.configuration.files import config_directory
        from squeal_rig.session.campaign import live_config

        parameters = live_config(campaign, config or config_directory() / "rig.yaml")
    _go_on(start(out, campaign, chunk, live), parameters, workers, scheduler)


@campaign_app.command("resume")
def campaign_resume(
    folder: CampaignFolder,
    config: Annotated[
        Optional[Path],
        typer.Option(help="Live: node parameters that it was begun with, where its folder does not keep them."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = "",
) -> None:
    """Go on with a campaign that ended early: what is measured stays, what was cut is measured from its start."""
    from squeal_rig.experiments.campaign.store import Store, header

    (campaign, first), parameters = header(folder), ""
    if first.get("live"):
        from squeal_rig.session.campaign import resumed_config

        parameters = resumed_config(folder, campaign, config)
    _go_on(Store.resume(folder), parameters, workers, scheduler)


@campaign_app.command("status")
def campaign_status(folder: CampaignFolder) -> None:
    """How far a campaign has come."""
    from squeal_rig.experiments.campaign.running import status

    for sentence in status(folder):
        console.print(sentence)


@campaign_app.command("report")
def campaign_report(folder: CampaignFolder) -> None:
    """Write the report of a campaign anew, of what is measured so far: one page, with PNG and CSV beside it."""
    from squeal_rig.experiments.campaign.pages import write_campaign_report

    console.print(f"report: {write_campaign_report(folder)}")


def _go_on(store: Any, parameters: str, workers: int | None, scheduler: str) -> None:
    """Measure what is missing; live with the text of a parameter file, without one by the engine."""
    from squeal_rig.experiments.campaign.pages import write_campaign_report
    from squeal_rig.experiments.campaign.running import Where, run_direct

    try:
        if parameters:
            from squeal_rig.graph import signals
            from squeal_rig.session.campaign import keep_config, run_live
            from squeal_rig.session.run import SignalWatch

            keep_config(store.folder, parameters)
            try:
                run_live(store, console, SignalWatch())
            finally:
                signals.ignore()  # what is left is to end
        else:
            run_direct(store, Where(workers, scheduler), lambda progress: console.print(str(progress)))
    finally:
        store.close()
    console.print(f"report: {write_campaign_report(store.folder)}")


@app.command()
@bag_app.command()
def info(
    bag: BagArgument,
    quick: Annotated[bool, typer.Option("--quick", help="Indexes only: count no samples.")] = False,
) -> None:
    """What a bag holds: topics, rates, gaps, rejected samples, provenance, how it ended."""
    from squeal_rig.report.bag_info import bag_info

    console.print(bag_info(bag, quick))


@bag_app.command()
def verify(bag: BagArgument) -> None:
    """Check all of a bag; exit code 0 when it is sound, 1 when not, 2 when it is no bag."""
    from squeal_rig.recording.verify import verify as verify_bag

    verdict = verify_bag(bag)
    console.print("\n".join(verdict.sentences()))
    raise typer.Exit(0 if verdict.sound else 1)


@bag_app.command()
def recover(
    file: Annotated[Path, typer.Argument(help="A damaged or unclosed .mcap file, or its folder.", metavar="FILE")],
    out: OutArgument,
) -> None:
    """Save every intact chunk into a new bag and tell what is lost; exit code 0 when nothing is, else 1."""
    from squeal_rig.recording.recover import recover as recover_bag

    report = recover_bag(file, out)
    console.print("\n".join(report.sentences()))
    raise typer.Exit(0 if report.complete else 1)


@bag_app.command()
def cut(
    bag: BagArgument,
    out: OutArgument,
    start: Annotated[float, typer.Option(help="Begin [s after the first message].", min=0.0, callback=_finite)] = 0.0,
    end: Annotated[
        Optional[float],
        typer.Option(help="End [s after the first message]; the bag's end by default.", callback=_finite),
    ] = None,
    topic: TopicsOption = None,
) -> None:
    """Copy a piece of a bag into a new one."""
    from squeal_rig.recording.rewrite import cut as cut_bag

    console.print(f"{cut_bag(bag, out, start, end, topic or ())} messages written to {out}")


@bag_app.command()
def merge(
    bags: Annotated[
        list[Path], typer.Argument(help="Two or more bags, then the new folder.", metavar="BAG... OUT_DIR")
    ],
) -> None:
    """Put several bags into one, in the order of time."""
    from squeal_rig.recording.rewrite import merge as merge_bags

    console.print(f"{merge_bags(bags[:-1], bags[-1])} messages written to {bags[-1]}")


@bag_app.command()
def export(
    bag: BagArgument,
    out: Annotated[Path, typer.Argument(help="Folder or file to write.", metavar="OUT")],
    to: Annotated[str, typer.Option(help="parquet, csv, hdf5 or wav.")],
    topic: TopicsOption = None,
    column: Annotated[Optional[list[str]], typer.Option(help="Column; may be given several times.")] = None,
    force: ForceOption = False,
) -> None:
    """Write the samples for other tools: one row a sample, units in the column's metadata."""
    from squeal_rig.samples.export import export_bag

    for file in export_bag(bag, to, out, topic or (), column or (), force):
        console.print(f"{file.path}: {file.topic}, {file.rows} rows, {file.size / 1e6:.1f} MB")
        if file.note:
            console.print(f"  {file.note}")


@bag_app.command()
def estimate(bag: BagArgument, out: OutArgument) -> None:
    """Compute friction and stability again from a bag, with today's code, and compare with what was recorded."""
    from squeal_rig.report.bag_reports import estimate_text

    console.print(estimate_text(bag, out))


def main() -> int:
    """Run the command line; bad input is one sentence and exit code 2."""
    close_to_strangers()
    try:
        app()
    except SquealRigError as error:
        sys.stderr.write(f"squeal-rig: {error}\n")
        return 2
    except OSError as error:  # of a path that is too long, that we may not look at, of a disk that is full
        named = "" if error.filename is None else f"{printable(str(error.filename))[:200]}: "
        sys.stderr.write(f"squeal-rig: {named}{error.strerror or printable(str(error))}\n")
        return 2
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] != "rclpy":
            raise
        sys.stderr.write(f"squeal-rig: {NO_ROS}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
