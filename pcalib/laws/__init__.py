"""Laws: what is missing where no listed effect explains the data, as channel × sharing × function.

    found = propose(problem(model, data))   # classes of laws that explain the residuals, best first
    written(law, theta, source)             # the text of an effect file

`channels` lists where a law may act, `functions` of what it may be a function, and `grammar` combines the two.
`search` finds the laws that gain most, `judge` puts them to the adequacy test of the diagnosis, and `writing` writes
them as files.
"""
