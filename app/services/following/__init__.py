"""Following a session: news that it changed, what changed, and a position to go on from after an interruption."""

from app.services.following.looking import Look, Start, look, start
from app.services.following.news import SessionNews
from app.services.following.position import Position

__all__ = ["Look", "Position", "SessionNews", "Start", "look", "start"]
