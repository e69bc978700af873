"""The display as a page in a browser: a tablet in the tank, or a screen with a kiosk browser.

``player.py`` is the device that the rig sees, ``server.py`` serves the page and its socket, ``mailbox.py`` is what both
share between their threads, ``wire.py`` is what they say to the page, ``page.html`` is the page. ``address.py`` and
``certificate.py`` are the way in.

Tried against Chromium, with pictures of its screen compared pixel by pixel; it has not met a real tablet.
"""

from drivers.stripe_player.player import StripePlayer

__all__ = ["StripePlayer"]
