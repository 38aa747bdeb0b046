"""What a camera that does not move sees of a nail: how it leans, and how its head moves aside.

`appearance` is what a nail looks like, `sight` where it is by the image.
"""
