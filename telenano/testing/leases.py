"""The lease of control of a rig, as other parties read and take it, for tests of programs that hold control."""


class LeaseOfRig:
    """The lease in the private folder of the rig, which TELENANO_RUNTIME_DIR names."""

    def __init__(self) -> None:
        from telenano.console.lease_register import LeaseRegister

        self._register = LeaseRegister()

    def holder(self) -> str:
        """Return the holder of control: the name of a person, otherwise the kind of program; empty if it is free."""
        holder = self._register.look().holder
        return "" if holder is None else holder.name or holder.what

    def lapse(self) -> None:
        """Let the time pass after which a silent holder counts as vanished."""
        from telenano.console.lease import VANISHED_NS, current

        self._register.change(lambda lease, now_ns: current(lease, now_ns + 2 * VANISHED_NS))

    def take_for_page(self, name: str) -> None:
        """Take control for the page of a person, from whoever holds it."""
        from telenano.console.lease import Party, take

        self._register.change(lambda lease, now_ns: take(lease, Party("page", name), now_ns, from_anyone=True))
