"""Studies: many runs and a report of them."""

from mpm.errors import SceneError


def refuse_settings(settings: list[str], decided: tuple[str, ...]):
    """Raise SceneError for each of the `settings` (KEY=VALUE) of a key that the study sets itself."""
    if taken := [item for item in settings if item.partition("=")[0].strip() in decided]:
        raise SceneError([f"--set {item}: the study sets it itself" for item in taken])
