"""The scene: modules for the user (`modules`), one record of tensors for the path tracer (`tables`), the way from one to the
other (`packing`), and what is kept between renderings (`cache`).
"""
