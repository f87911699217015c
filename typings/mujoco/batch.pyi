# MuJoCo's names come from compiled modules without stubs: all of them are taken as they are.
from typing import Any

def __getattr__(name: str) -> Any: ...
