"""The Typer application to which every module adds its commands."""

from .outputs import GuardedTyper

app = GuardedTyper(
    name="manifold",
    help="Learn a manifold of materials from measured spectral BRDFs, and predict BRDFs that were not measured.",
    epilog="Start with `manifold demo`, which runs everything on the built-in synthetic corpus.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
