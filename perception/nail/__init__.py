"""What a camera that does not move sees of a nail: how it leans, and how its head moves aside.

`appearance` is what a nail looks like, `fit` where it stands as it was set, `change` what has changed since then
and where its head is now, `sight` all of it.
"""
