"""Specs under the names by which Python takes them, as in `window=nt.Window(length_ms=150)`."""

from neurotact.data.contact import OnsetSpec
from neurotact.data.readers.columns import LayoutSpec
from neurotact.data.readers.specs import EventSpec, NamingSpec
from neurotact.data.splits import Splits
from neurotact.data.windows import WindowSpec
from neurotact.networks.definition.learned import LearnSpec
from neurotact.networks.definition.space import SearchSpec

Events, Layout, Naming, Onset = EventSpec, LayoutSpec, NamingSpec, OnsetSpec
Learn, Search, Split, Window = LearnSpec, SearchSpec, Splits, WindowSpec
