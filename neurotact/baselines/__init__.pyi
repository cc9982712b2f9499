from .opponent import Opponent as Opponent
