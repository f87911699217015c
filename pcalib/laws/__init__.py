"""Laws: what is missing where no listed effect explains the data, as channel × sharing × function.

    found = propose(problem(model, data))     # classes of laws that explain the residuals, best first
    written(found.classes[0].first)           # the text of an effect file

`channels` lists where a law may act, `functions` of what it may be a function, `grammar` combines the two, `search`
judges every law by the screen and the adequacy test of the diagnosis, and `writing` writes a law as an effect file.
"""
