"""What pyproject.toml cannot say: a wheel carries the robots of models/ inside the package, to be found by name."""

from __future__ import annotations

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class WithModels(build_py):
    """Also copies models/ to pcalib/models; an editable installation reads models/ itself."""

    def run(self) -> None:
        """Copy the package, and the robots into it."""
        super().run()
        if not self.editable_mode:
            shutil.copytree("models", Path(self.build_lib, "pcalib", "models"), dirs_exist_ok=True)


setup(cmdclass={"build_py": WithModels})
