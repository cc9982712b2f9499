"""A trained chain on a local page: touch becomes a decision before one's eyes, and sliders change the running stream.

One `deploy.stream.Stream` decides; this room shows it.

- `feeds`: where samples come from: recordings at their own rate, a device, a simulated finger moved by hand.
- `session`: the thread that feeds the stream and obeys the page.
- `scores`: what the decided windows cost and how often they were right, before and after a change.
- `frames`: what a page draws, in bounded pieces, and the mailbox of each page, where the newest piece wins.
- `messages`: what a page may ask for.
- `server`: loopback alone, a token in the address, one file.
"""
