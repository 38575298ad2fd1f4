"""What a build adds to the package `sfol`: a wheel, its knowledge bases; a checkout, the street."""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CustomBuildHook(BuildHookInterface):
    """Keeps apart what a wheel and what an editable installation of a checkout have.

    A wheel is the logic alone: the packages `env` and `vsr` are found in a checkout, and a wheel
    that carried them would replace those of the same name in somebody's site-packages. So only an
    editable installation has the commands and plug-ins that need them.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add what belongs to a build.

        Args:
            version: ``editable`` or ``standard``.
            build_data: what the build is made of; changed in place.
        """
        if version != "editable":
            build_data["force_include"]["rules"] = "sfol/rules"
            return
        core = self.metadata.core
        core.scripts.update(self.config["scripts"])
        core.entry_points.update(self.config["entry-points"])
