"""The lighting models, and the one that a session's options select."""

from dataclasses import replace

from roomlight.engine.models.classical import ClassicalModel, ClassicalProbe
from roomlight.engine.models.network_probe import NetworkProbe
from roomlight.engine.models.network_volume import NetworkModel
from roomlight.engine.networks.graphs import DESCRIPTION, SHIPPED, LightingGraphs, load_graphs, part_files, part_folder
from roomlight.engine.options import SessionOptions
from roomlight.engine.panorama.prior import shipped_prior
from roomlight.errors import ModelError, OptionError

LightingModel = ClassicalModel | NetworkModel
ProbeEstimator = ClassicalProbe | NetworkProbe


def choose_graphs(options: SessionOptions) -> LightingGraphs | None:
    """Load the graphs that the options select; None for the classical model. Load once, share between sessions.

    Raises:
        OptionError: model="video" contradicts `weights`, which are single-view.
        ModelError: The weights are missing, damaged or untrained, or the provider is not available.
    """
    if options.model == "classical":
        return None
    if options.weights is not None:
        graphs = load_graphs(options.weights, provider=options.provider)
        if options.model == "video" and graphs.form == "single":
            raise OptionError(f'{options.weights}: holds single-view weights only; use model="single" or "auto"')
        return replace(graphs, form="single") if options.model == "single" else graphs
    form = "video" if options.model == "video" else "single"
    for folder in ("video",) if form == "video" else ("single", "video"):  # a video folder holds the single-view graphs
        if (SHIPPED / folder / DESCRIPTION).is_file():
            return replace(load_graphs(SHIPPED / folder, provider=options.provider), form=form)
    raise ModelError(
        f'model="{options.model}": this version contains no trained weights for it; '
        'set `weights` to a model directory (from `roomlight export`) or use model="classical"'
    )


def lighting_model(options: SessionOptions, graphs: LightingGraphs | None = None) -> LightingModel:
    """Return the model of a session; `graphs` are those that the options select unless given.

    Raises:
        OptionError: The options contradict each other (see `choose_graphs`).
        ModelError: The weights cannot be used (see `choose_graphs`).
    """
    graphs = graphs or choose_graphs(options)
    if graphs is None:
        return ClassicalModel()
    folder = part_folder(options.parts, "prior")
    return NetworkModel(graphs, options.hedge, shipped_prior(folder, part_files(folder)))
