"""Cells that begin with %%bash print in one piece, not every hundred bytes; their failures stop the build."""

import subprocess

from IPython import get_ipython


def bash(line, cell):
    """Take the place of IPython's own magic; a startup file of the notebooks' profile."""
    output = subprocess.run(["bash", "-e"], input=cell, text=True, stdout=subprocess.PIPE, check=True).stdout
    if output:
        print(output)


get_ipython().register_magic_function(bash, "cell")
