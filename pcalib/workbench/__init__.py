"""The loop in a window: a page in the browser whose every action is a command of `pcalib`.

    session  the folder of a session: data, robot, models, figures, and the commands that made them
    actions  from what is clicked to the words of a command
    worker   commands run one after the other in a process of their own, and may be cancelled
    server   the page, what it asks for, and who may ask

The page shows what the commands wrote, and computes nothing: its figures are theirs.
"""
