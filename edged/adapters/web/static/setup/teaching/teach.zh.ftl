# Texts of the page that teaches a job.

teach-title = 示教
teach-what = 让两台相机同时看一次工件。edged 会建议用哪些特征测量，并在每次点按时说明坐标的精度。
teach-no-rig = 还没有标定：没有标定，图像就没有毫米尺度。

## How one begins
teach-begin = 新工件
teach-begin-what = 把工件放在要测量的位置，周围不要有其他物体。
teach-take = 拍摄图像对
teach-taking = 请稍候 …
teach-take-cell = 拍摄图像对需要相机：请先接管单元。
teach-known = 本单元的作业
teach-known-what = 在示教所用的图像对上更改作业，或重新示教。在启用新作业之前，原作业保持不变。
teach-edit = 更改
teach-edit-job = 更改 { $name }
teach-again = 重新示教
teach-again-job = 重新示教：{ $name }，用新的图像对

## The draft
teach-undo = 撤销
teach-redo = 重做
teach-undone = 已撤销。
teach-redone = 已重做。
teach-other = 另一工件
teach-discard-what = 图像对及其上的所有选择都会删除。使用中的作业保留。
teach-changes = 更改 { $job }
teach-proposing = 正在查找可测量的特征 …
teach-trouble = 目前还无法由此示教：

## What it is worth
teach-predicted = 该工件在当前位置的预期精度
teach-predicted-later = 请点按左图中的工件。
teach-predicted-none = 所选特征无法确定位置：至少选一个圆、一个长圆孔或两条边。
teach-free = 未知：无法区分
teach-better = 原为 ± { $before }
teach-worse = 原为 ± { $before }
teach-no-rivals = 没有其他转角与它相似。
teach-rival = 转动 { $angle }° 后相似度 { $percent } %：请选一个在该处不同的特征，否则转角可能出错。
teach-far-rival = 转动 { $angle }° 后相似度 { $percent } %：仍可区分。

## The pictures
teach-tools = 点按左图的作用
teach-choose = 选择特征
teach-now-choose = 点按轮廓或孔的中心：实线并打勾为采用，虚线为不采用。
teach-now-reference = 点按要输出坐标的点：edged 取该处特征的中心。
teach-now-gripping = 点按夹爪应抓取的位置。
teach-picture-left = 左图。方向键移动十字线，回车在该处点按，加减键缩放，0 显示全部。
teach-picture-right = 右图，同一部分
teach-look = 查看
teach-look-at = 查看 { $key }
teach-place-reference = 参考点
teach-place-gripping = 抓取点
teach-place-reference-said = 已设定参考点。
teach-place-gripping-said = 已设定抓取点。

## Where the part is
teach-part = 工件在哪里
teach-tool-tap = 点按
teach-tool-rectangle = 矩形
teach-tool-circle = 圆
teach-tool-polygon = 多边形
teach-tool-brush = 擦除
teach-tool-tap-what = 点按工件：区域扩展到其轮廓。
teach-tool-rectangle-what = 从一角拖到对角，或点按两角。
teach-tool-circle-what = 从圆心拖到边缘，或点按两处。
teach-tool-polygon-what = 逐个点按各角；再点第一个即闭合。
teach-tool-brush-what = 涂掉不属于工件的部分，例如阴影或标签。
teach-cut = 挖除
teach-place = 在中间放一个
teach-close = 闭合
teach-no-region = 尚无区域：将学习整幅图像。
teach-adds = { $kind } { $shape }
teach-cuts = { $kind } { $shape }，已挖除
teach-remove = 删除
teach-remove-shape = 删除形状 { $shape }
teach-shape-rectangle = 矩形
teach-shape-circle = 圆
teach-shape-polygon = 轮廓
teach-shape-brush = 擦除笔迹
teach-handle = { $kind } { $shape }，点 { $point }：{ $x }，{ $y } px。方向键可移动。

## Features
teach-features = 特征：{ $count } 个中采用 { $taken } 个
teach-features-what = edged 用采用的特征测量。模糊的或会在工件上移动的请不要采用。
teach-no-features = 单元知道工件位置后，特征会显示在此。
teach-take-all = 全部采用
teach-taken-said = 已采用 { $key }。
teach-left-said = 已不采用 { $key }。
teach-kind-circle = 圆
teach-kind-slot = 长圆孔
teach-kind-edge = 边
teach-kind-corner = 角点
teach-kind-curve = 曲线
teach-size-diameter = Ø { $mm } mm
teach-size-length = 长 { $mm } mm
teach-size-width = 宽 { $mm } mm
teach-why-not-seen = 在此图像对中未看到
teach-why-left-out = 已被人工排除
teach-warnings = 请检查
teach-warning-cut = 轮廓被截断。
teach-warning-round = 它是圆的：无法确定转角。
teach-warning-symmetric = 转动后看起来相同。
teach-warning-confusable = 转动后看起来很相似。
teach-warning-weak = 对比度低：请增加光照，或从侧面打光。
teach-warning-few-points = 边缘太少：取更大或更清晰的部分会更好。
teach-warning-few-levels = 在图像中太小：相机靠近一些会更好。
teach-warning-lopsided = 一个方向的精度远低于另一个方向。
teach-warning-bright-walls = 侧壁与表面一样亮：孔看起来过深。
teach-warning-uneven = 同一表面的边缘高度不一致。
teach-warning-one-pair = 一组图像无法显示边缘倒角。
teach-warning-not-found = 在自己的图像中也未能再次找到。

## Points and sizes
teach-reference = 参考点
teach-reference-what = PLC 和机器人得到其坐标的点。建议：精度最高的点。
teach-reference-tap = 在图像中点按
teach-reference-feature = 或取其中心：
teach-gripping = 抓取点
teach-gripping-what = 夹爪抓取的位置（若不同于参考点）：从参考点起，沿工件自身的轴。
teach-gripping-tap = 点按
teach-gripping-type = 输入
teach-gripping-none = 无其他位置
teach-tray = 料盘
teach-tray-what = 工件放在料盘格中：行与列等间距，由角上格中工件报告的位置确定。
teach-tray-columns = 列
teach-tray-rows = 行
teach-tray-tolerance = 公差
teach-tray-first = 第一格
teach-tray-row-end = 第一行的最后一格
teach-tray-column-end = 最后一行的第一格
teach-tray-type = 描述料盘
teach-tray-none = 无料盘
teach-sizes = 要检查的尺寸
teach-sizes-what = 每个工件都会测量。超出标称值 ± 公差的工件为不合格。
teach-size-of = 从
teach-size-to = 到
teach-size-kind = 量
teach-size-witness = 在每个工件上验证标定的尺寸：始终测量。
teach-size-alone = –（自身的尺寸）
teach-size-add = 添加此尺寸
teach-size-good = 公差内
teach-size-bad = 超差
teach-size-remove = 删除尺寸 { $name }
teach-nominal = 标称值
teach-tolerance = 公差 ±
teach-measure-radius = 半径
teach-measure-distance = 距离
teach-measure-angle = 角度
teach-measure-width = 宽度
teach-measure-length = 长度
teach-measure-height = 高度
teach-measure-flatness = 平面度

## Its release
teach-job = 作业
teach-name = 名称
teach-name-wrong = 字母、数字、“_”、“.”或“-”，以字母或数字开头
teach-number = PLC 中的编号
teach-activate = 使用此作业
teach-try = 先试运行
teach-activate-title = 使用 { $name }？
teach-activate-what = 它会成为一个单独的版本。若有失败，原版本保留；您可以在版本列表中返回。
teach-activated = { $name } 已使用，版本 { $number }。

## What teaches nothing
problem-teach-no-feature = 没有两台相机都能看到的圆、长圆孔或直边。请把工件放在两台相机前，打光，然后点按它。
problem-teach-one-sided = 左图中的内容在右图中找不到。工件在两台相机前吗，中间有没有遮挡？否则标定属于其他相机：请检查。
problem-teach-patterned-table = 工件周围是孔板的孔，而工件本身只有同轴的圆，无法确定转角。请放到平整无孔的台面上示教，或添加其 STEP 文件。
problem-teach-small-region = 选区为空或太小：请点按工件，或在其周围画线。
problem-teach-crossing = 工件周围的线相交：请沿四周依次放置各角。
problem-teach-few-edges = 选区中边缘太少。工件在其中、光照充足且对焦清晰吗？
problem-teach-nothing-there = 那里没有清晰的轮廓。请在工件周围画线，或调整光照使其与台面区分开。
problem-teach-no-pair = 此作业在别处示教，没有保存图像对：请用新的图像对示教。
problem-teach-nothing-left = 没有可用于测量的特征：至少采用一个圆、一个长圆孔或两条边。
problem-teach-no-pictures = 该循环没有图像：相机没有输出。
problem-teach-other-rig = 该循环使用另一标定测量，其图像内容的位置现已不同。请选用较新的循环。
problem-teach-further-none = 图像对 { $pair } 的两幅图像中没有完整显示一个该工件：请重拍，或将其移除。
problem-teach-further-little = 所有图像对合起来显示的工件内容仍太少。
problem-teach-further-needless = 该工件的曲线太少，无法从更多图像对中学习：请将其移除。
problem-teach-further-size = 该图像对的尺寸与第一对不同。

teach-further = 更多图像对
teach-further-what = 加工棱边带有倒角或圆角，正对相机放置的工件看不出其形状。将工件倾斜 10 至 40 度，或改变光照，然后添加该图像对。
teach-further-add = 添加图像对
teach-further-said = 已添加图像对。
teach-further-removed = 已移除图像对。
teach-further-pair = 图像对 { $number }
teach-further-remove-pair = 删除图像对 { $number }
teach-further-open = 棱边倒角的形状尚未确定：由每幅图像重新判断，其可信程度见 σ。
teach-further-none = 棱边为锐边。
teach-further-face = 棱边倒角 { $width } mm；示教的是顶面一侧的边缘。
teach-further-wall = 棱边倒角 { $width } mm；示教的是侧壁一侧的边缘。
teach-further-either = 棱边倒角 { $width } mm；示教的可能是任一侧的边缘。

## A drawing instead of the region
teach-drawing = 图纸
teach-drawing-what = 可用相机所见面的 DXF 图纸示教作业：作业采用图纸的尺寸。图像对显示工件的位置。
teach-drawing-is = 由 { $name } 示教，其面距左相机 { $depth } mm。
teach-drawing-back = 点按工件或另选区域，将重新由图像对示教。
teach-drawing-more = 单位、距离、图层
teach-drawing-unit = 单位
teach-drawing-unit-own = 按图纸
teach-drawing-depth = 面的距离；留空：按图像对所示
teach-drawing-layers = 图层，用逗号分隔；留空：所有可见图层
teach-drawing-choose = 选择 DXF 文件
teach-drawing-reading = 正在读取 …
teach-drawing-said = 作业已由 { $name } 示教。
problem-teach-drawing-no-dxf = 不是可读取的 DXF 图纸。请重新导出为 DXF。
problem-teach-drawing-unit = 图纸未注明单位：请在“单位、距离、图层”中选择，然后重新选择文件。
problem-teach-drawing-layer = 图纸中没有此图层。有：{ $there }
problem-teach-drawing-large = 不是单个工件的图纸：图形、点或字节过多。请只导出该面。
problem-teach-drawing-flat = 图纸不是平面的：请将该面导出为 x-y 平面内的线。
problem-teach-drawing-empty = 图纸中没有封闭轮廓。可读取直线、圆弧、圆和多段线。
problem-teach-drawing-open = 有轮廓未闭合：止于 x { $x }、y { $y } mm。请闭合它，或指定工件的图层。
problem-teach-drawing-branch = 在 x { $x }、y { $y } mm 处没有轮廓闭合：有分支或重复的线。请更正，或指定工件的图层。
problem-teach-drawing = 图纸无法使用：{ $detail }
problem-teach-drawing-depth = 图像对无法显示面的距离：请给出它到左相机的距离。
problem-teach-drawing-unread = 浏览器无法读取此文件。
problem-teach-not-as-drawn = 图像对中没有与图纸相似的内容。它是相机所见的面吗，没有镜像，单位和距离正确，并且完整出现在两张图像中吗？
