"""What pyproject.toml cannot say: a wheel carries the robots of models/, and the extension in C is optional."""

from __future__ import annotations

import shutil
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_py import build_py

NATIVE = Extension(
    "pcalib._native",
    [f"native/{shape}.c" for shape in ("three_arms", "six_arms", "two_bodies", "plane")],
    include_dirs=["pcalib/export"],
    depends=["native/batch.c", "pcalib/export/kernel.c"],
    extra_compile_args=["-O3", "-fno-math-errno", "-fno-trapping-math"],  # no code looks at errno or at floating traps
    optional=True,  # without a compiler that takes it, NumPy does the same
)


class WithModels(build_py):
    """Also copies models/ to pcalib/models; an editable installation reads models/ itself."""

    def run(self) -> None:
        """Copy the package, and the robots into it."""
        super().run()
        if not self.editable_mode:
            shutil.copytree("models", Path(self.build_lib, "pcalib", "models"), dirs_exist_ok=True)


setup(cmdclass={"build_py": WithModels}, ext_modules=[NATIVE])
