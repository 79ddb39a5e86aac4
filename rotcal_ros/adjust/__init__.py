"""The engine of adjustment: what residuals say of groups of observations, for any method.

A method without algebra of its own hands over a :class:`~.model.Model` and gets all from
:func:`~.engine.adjust`: start, noise, causes, verdict (docs/engine.md).

Methods with an algebra of their own use its parts, which know no method, only the linear view at a
solution (:mod:`.groups`): whitened residuals r, their cofactor R = I - J N^-1 J' and the response
B = C N^-1 J' of the outputs, group by group:

1. It makes a :class:`~.groups.Group` for every station, position, target, ball or stretch of time:
   the rows in use, how they form elements, what unit shifts are in whitened units, and which
   subsets gather (:mod:`.subsets`: neighbours in direction or place, runs in time). Small problems
   take them from :class:`~.groups.Dense`.
2. :func:`~.groups.group_test` says of each whether its chi-squared fits its redundancy, before any
   single observation is judged.
3. :func:`~.judgement.judge` says how probably something gathers in one of them. Where this is
   ``proved``, :func:`~.judgement.most_probable_subset` of its ``worst`` group says which elements
   to leave out: the method drops those rows, adjusts again, and asks again.
4. What rivals explain as well, ``Blame.root``, and what is probable but not proved,
   ``Judgement.covariance``, is added to the covariance of the outputs. A verdict is "suspect"
   where something was blamed, all the more where that is ``ambiguous``.
5. :func:`~.reliability.largest_undetectable_shift` says how large an error may stay unseen: a
protection.

Noise that was estimated from the same residuals is stated by ``rest``; then each group is judged
by what the others scatter.
"""
