"""The help of a command: its options in groups, and at the end an example."""

from typing import Any

from typer.core import TyperCommand

EXAMPLES = {
    "list": "neurotact list",
    "show": "neurotact show sa1-ra1-lif",
    "copy": "neurotact copy sa1-ra1-lif -o mine.toml",
    "simulate gratings": "neurotact simulate gratings -o touches.h5 --set trials=20",
    "simulate gratings-slips": "neurotact simulate gratings-slips -o slips.h5 --set recordings=20",
    "simulate stiffness": "neurotact simulate stiffness -o grasps.h5",
    "simulate touch-modality": "neurotact simulate touch-modality -o touches.h5",
    "simulate contact-materials": "neurotact simulate contact-materials -o contacts.h5",
    "simulate compliance": "neurotact simulate compliance -o squeezes.h5",
    "fetch": "neurotact fetch fabricslide",
    "import folder": "neurotact import folder my-data/ --unit count --levels label,speed -o touches.h5",
    "import table": "neurotact import table touches.csv --unit mV --trial trial --label label -o touches.h5",
    "import arrays": "neurotact import arrays touches.npz --unit mV --sampling-rate-Hz 1000 -o touches.h5",
    "import raster": "neurotact import raster rasters.npz --sampling-rate-Hz 1000 -o spikes.h5",
    "import events": "neurotact import events events.csv --step-ms 1 -o spikes.h5",
    "import nwb": "neurotact import nwb units.nwb --label texture -o spikes.h5",
    "import braille-letters": "neurotact import braille-letters braille/ -o letters.h5",
    "import fabricslide": "neurotact import fabricslide fabricslide/ -o fabrics.h5",
    "import pvdf-hardness": "neurotact import pvdf-hardness pvdf/ -o presses.h5",
    "import touch-modality": "neurotact import touch-modality touches/ -o touches.h5",
    "import st-mnist": "neurotact import st-mnist st-mnist/ -o digits.h5",
    "import stemnist": "neurotact import stemnist stemnist/ -o characters.h5",
    "import stemnist-pressure": "neurotact import stemnist-pressure stemnist/ -o pressure.h5",
    "import vt-snn": "neurotact import vt-snn vt-snn/ -o containers.h5",
    "import cost": "neurotact import cost CoST.csv -o gestures.h5",
    "import cluster-haptic-texture": "neurotact import cluster-haptic-texture texture_dataset/ -o textures.h5",
    "info": "neurotact info touches.h5",
    "calibrate": "neurotact calibrate touches.h5 -o mine.toml",
    "encode": "neurotact encode touches.h5 --encoder mine.toml -o spikes.h5",
    "raster": "neurotact raster spikes.h5 --trial 3 -o raster.png",
    "train": "neurotact train spikes.h5 -o run/ --window-ms 500 --test-where speed=450",
    "tune": "neurotact tune spikes.h5 -o search/ --trials 40 --max-sops 3000",
    "infer": "neurotact infer run/ spikes.h5 --early-exit",
    "conditions-curve": "neurotact conditions-curve spikes.h5 speed --figure curve.png",
    "sops": "neurotact sops run/ -o sops.csv",
    "save": "neurotact save run/ -o small/ --at-most-points 1",
    "learn": "neurotact learn run/ silk.h5 -o run-with-silk/ --touches 5",
    "fine-tune": "neurotact fine-tune run/ -o run-4-bit/ --weight-bits 4",
    "stream": "neurotact stream run/ --from serial:/dev/ttyUSB0",
    "live": "neurotact live run/ --from gratings",
    "export": "neurotact export run/ --to c -o chain/",
    "study run": "neurotact study run own-recordings --data touches.h5 --quick -o mine/",
    "study resume": "neurotact study resume mine/",
    "study report": "neurotact study report mine/",
    "study bundle": "neurotact study bundle mine/ -o bundle/ --width nature-column",
}
"""An example of each command, by its name; a command of another package may have none."""

TASKS = {
    "From recordings to an answer": "study",
    "Recordings": "import fetch simulate info",
    "Spikes": "calibrate encode raster",
    "Networks": "train infer sops tune save learn conditions-curve",
    "Devices": "stream live export fine-tune",
    "Specs": "list show copy",
}
"""The commands by what a user wants to do, as the help of the program shows them."""

GROUPS = {
    "Windows": "--window-ms --start-ms --hop-ms --per-trial --align --rest-ms --onset-deviations",
    "Trials and split": "--where --leave-out --test-where --group --order --folds --fold --repeats --stratify "
    "--split-seed",
    "Early exit": "--exit-tolerance",
}
"""Options that stand together in the help of a command that has some of each group."""
LEAST = 20
"""Options from which on they are grouped."""


class Command(TyperCommand):
    """A command whose help has groups of options, where there are many, and ends in an example."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        options = [param for param in self.get_params(ctx) if param.param_type_name == "option"]
        group_of = {name: group for group, names in GROUPS.items() for name in names.split()}
        if len(options) < LEAST or not {*group_of.values()} <= {group_of.get(param.opts[0]) for param in options}:
            super().format_options(ctx, formatter)
            return
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": [], **{group: [] for group in GROUPS}}
        for param in self.get_params(ctx):
            row = param.get_help_record(ctx)
            if row:
                is_option = param.param_type_name == "option"
                sections[group_of.get(param.opts[0], "Options") if is_option else "Arguments"].append(row)
        for name, rows in sections.items():
            if rows:
                with formatter.section(name):
                    formatter.write_dl(rows)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        super().format_epilog(ctx, formatter)
        example = EXAMPLES.get(ctx.command_path.partition(" ")[2])
        if example:
            with formatter.section("Example"):
                formatter.write(f"{'':{formatter.current_indent}}{example}\n")
