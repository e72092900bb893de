"""A law of one's own: its two halves as pure steps, and what the laws of this project are built from."""

from services.controller.law import NO_SIGNAL as NO_SIGNAL
from services.controller.law import EnergyAccount as EnergyAccount
from services.controller.law import HandSample as HandSample
from services.controller.law import Law as Law
from services.controller.law import MasterReference as MasterReference
from services.controller.law import PortSignal as PortSignal
from services.controller.law import SlaveReference as SlaveReference
from services.controller.law import TipMeasurement as TipMeasurement
from services.controller.law import port_signal as port_signal
from services.controller.law import tip_signal as tip_signal
from services.controller.laws.shared import pass_through as pass_through
from services.controller.laws.shared.virtual_mass import Mass as Mass
from services.controller.laws.shared.virtual_mass import MassConfig as MassConfig
from services.controller.laws.shared.virtual_mass import MassParams as MassParams
from services.controller.laws.shared.virtual_mass import ScaledConfig as ScaledConfig
from services.controller.laws.shared.virtual_mass import at_rest as at_rest
from services.controller.laws.shared.virtual_mass import is_coupled as is_coupled
from services.controller.laws.shared.virtual_mass import let_go as let_go
from services.controller.laws.shared.virtual_mass import moved as moved
from services.controller.laws.shared.virtual_mass import periods_in as periods_in
from services.controller.laws.shared.virtual_mass import rescaled as rescaled
from services.controller.laws.shared.virtual_mass import resumed as resumed
from services.controller.laws.shared.virtual_mass import tip_reference as tip_reference
from services.numerics.compiled import compiled as compiled
