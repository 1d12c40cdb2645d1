"""The application that every module of commands adds its own to."""

from .outputs import GuardedTyper

app = GuardedTyper(
    name="manifold",
    help="Turn measured spectral BRDFs into a manifold of materials, and predict materials nobody measured.",
    epilog="Start with `manifold demo`, which runs everything on the built-in synthetic corpus.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
