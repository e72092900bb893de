"""Roles of the columns of a force curve, such as base, force or time, from their names in many languages."""

import re
import unicodedata

# The first match decides, so that a lateral force is not taken for a force, nor a separation for a base height.
_ROLES = (
    ("lateral", r"lateral|friction|torsion|horizontal|\bhdefl|reibung|querkraft|frottement|friccion|attrito|wrijving|"
                r"torcion|\blfm\b|\bl-r\b|twist|shear|scher|cisaill|摩擦|侧向|横向|латерал|трени|кручени"),
    ("amplitude", r"amplitud|(?<!s)ampl|\bamp\b|^r$|振幅|амплитуд"),
    ("phase", r"phas|\bfase\b|相位|фаза"),
    ("sum", r"\bsum|somme|\bsuma\b|\bsomma\b|intensi|\btotal\b|сумма"),
    ("time", r"time|zeit|temps\b|tiempo|\btempo\b|\btijd\b|时间|время|^t$|\bsec"),
    ("index", r"index|indice|\bpoints?\b|punkt|^nr\b|^no\b|^n$|\brow\b|zeile|sample number"),
    ("current", r"current|\bstrom\b|courant|corriente|corrente|电流|ток\b"),
    ("frequency", r"freq|\bdf\b|频率|частот"),
    ("separation", r"separa|tip.{0,3}sample|spitze.{0,3}probe|probe.{0,3}spitze|\btss\b|\btsd\b|"
                   r"pointe.{0,3}echantillon|punta.{0,3}(?:muestra|campione)|\bgap\b|indent|eindring|分离|зазор"),
    ("force", r"force|kraft|fuerza|forza|kracht|^f$|\bload\b|\blast\b|力|сила|\bfn\b|\bfz\b|^f "),
    ("deflection", r"defl|vertical|normal|auslenk|verbieg|durchbieg|deflex|fleche|flessione|bending|doorbuig|\ba-b\b|"
                   r"\bt-b\b|top-bottom|^d$|偏转|挠度|отклон|изгиб|прогиб"),
    ("base", r"piezo|\bz|z\b|height|hohe|hoehe|hauteur|altura|altezza|hoogte|ramp|\bway\b|\bweg\b|zsn|snsr|lvdt|distan|"
             r"abstand|afstand|\bdist|position|scanner|stage|高度|位移|压电|высот|перемещ|пьезо|positie|posicion"),
)  # fmt: skip
_PATTERNS = tuple((role, re.compile(words)) for role, words in _ROLES)


def role_of(name: str) -> str:
    """Return the role of a column of a force curve according to its name; empty if the name does not tell.

    The roles are base (the travel or height that is moved), separation, force, deflection, lateral, amplitude, phase,
    sum, time, index, current and frequency.

    Example:
        >>> role_of("Lateral force"), role_of("Normalkraft"), role_of("Höhe"), role_of("Ch1")
        ('lateral', 'force', 'base', '')
    """
    plain = "".join(one for one in unicodedata.normalize("NFKD", name) if not unicodedata.combining(one))
    # Split words at underscores and before capitals: Calc_Ramp_Ex, heightSensor.
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", plain.replace("_", " ")).lower()
    return next((role for role, words in _PATTERNS if words.search(parted) or words.search(plain.lower())), "")
