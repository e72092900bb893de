"""The topic `afm/particles` with the true places of simulated particles (`telenano.topics`)."""

from typing import Annotated

from telenano.wire import Array, Lengths, Message, Topic, about


class AfmParticles(Message):
    """Where the particles of a simulated instrument really are: no instrument knows it, and who plans must not read it.

    For who judges a session afterwards; 20 times a second while one moves, else once a second.
    """

    simulated: Annotated[
        bool,
        about(
            "Always true: this is the truth of a simulation, and no measurement",
            extra_json_schema={"const": True, "examples": [True]},
        ),
    ]
    places_m: Annotated[Lengths, about("Centres on the sample, 0, 0 its middle, shape (n, 2) [m]")]
    radii_m: Annotated[Lengths, about("Radii, shape (n,) [m]")]
    moving: Annotated[Array, about("Which of them have moved within their time of rest, shape (n,), 0 or 1")]

    def __post_init__(self) -> None:
        """Raise ValueError for what is said to be no simulation."""
        if self.simulated is not True:
            raise ValueError("simulated must be true: no instrument knows where particles are")


# No node reads this topic, and no link carries it.
AFM_PARTICLES = Topic("afm/particles", AfmParticles, ("afm_node",), "lossless", None, None, None)
