"""Inheritance of the operator's page: the launcher binds its address, so that restarts of the page keep the address."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from telenano.launcher.plan import Plan
from telenano.launcher.processes import Inheritance
from telenano.serving.access import OBSERVER_VARIABLE, OPERATOR_VARIABLE, PARTICIPANT_VARIABLE
from telenano.serving.config import ViewConfig
from telenano.serving.serve import SOCKET_VARIABLE, addresses_of, announced, missing_for_view
from telenano.wire.errors import TelenanoError
from telenano.wire.nodes import PAGE, name_of

# The beginning of the line that says why a rig has no page.
NO_PAGE = "no view: "


@contextlib.contextmanager
def inherited_by_page(plan: Plan, show: Callable[[str], Any]) -> Iterator[dict[str, Inheritance]]:
    """Bind and show the address of a rig's page while the block runs; yield the inheritance of its process, by node.

    The mapping is empty if no page is planned or it cannot be served. The reason is shown, and the rig runs without it.
    """
    with contextlib.ExitStack() as stack:
        inherited = {}
        try:
            if reason := _missing(plan):
                show(f"{NO_PAGE}{reason}")
            elif plan.page:
                inherited = {PAGE: _bound(plan, show, stack)}
        except (TelenanoError, OSError) as error:
            show(f"{NO_PAGE}{error}")
        yield inherited


def _missing(plan: Plan) -> str:
    if plan.page and PAGE not in plan.book.nodes:
        return f"{plan.site_file} has no {PAGE}"
    return missing_for_view() if plan.page else ""


def _bound(plan: Plan, show: Callable[[str], Any], stack: contextlib.ExitStack) -> Inheritance:
    config = plan.loaded.section(name_of(PAGE), ViewConfig)
    tls, access = config.tls(), config.access()
    bound = stack.enter_context(config.bind())
    addresses = addresses_of(bound, access, tls, config.name)
    shown = {"view" if name == "operator" else name: each for name, each in addresses.items()}
    stack.enter_context(announced(shown, show))
    tokens = {
        OPERATOR_VARIABLE: access.operator_token,
        OBSERVER_VARIABLE: access.observer_token,
        PARTICIPANT_VARIABLE: access.participant_token,
    }
    return Inheritance({**tokens, SOCKET_VARIABLE: str(bound.fileno())}, (bound.fileno(),))
