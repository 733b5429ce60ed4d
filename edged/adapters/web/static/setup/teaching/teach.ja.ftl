# Texts of the page that teaches a job.

teach-title = ティーチング
teach-what = ワークを両方のカメラに一度見せます。edged が測定に使う特徴を提案し、タップのたびに座標の精度を示します。
teach-no-rig = キャリブレーションがまだありません。これがないと画像から mm を求められません。

## How one begins
teach-begin = 新しいワーク
teach-begin-what = 測定する場所にワークを置き、周りには何も置かないでください。
teach-take = 画像ペアを撮影
teach-taking = しばらくお待ちください…
teach-take-cell = 撮影にはカメラが必要です。セルを取得してください。
teach-known = このセルのジョブ
teach-known-what = ティーチングに使った画像ペア上で変更するか、ティーチングし直します。新しいものを使用するまで元のままです。
teach-edit = 変更
teach-edit-job = { $name } を変更
teach-again = 再ティーチング
teach-again-job = 再ティーチング：{ $name }、新しい画像ペアで

## The draft
teach-undo = 元に戻す
teach-redo = やり直す
teach-undone = 元に戻しました。
teach-redone = やり直しました。
teach-other = 別のワーク
teach-discard-what = 画像ペアとその上で選んだものはすべて失われます。使用中のジョブは残ります。
teach-changes = { $job } の変更
teach-proposing = 測定できるものを探しています…
teach-trouble = まだティーチングできません：

## What it is worth
teach-predicted = このワーク、今の位置での見込み
teach-predicted-later = 左の画像のワークをタップしてください。
teach-predicted-none = 選択した特徴では位置が決まりません。円 1 つ、長穴 1 つ、またはエッジ 2 本以上を選んでください。
teach-free = 不明：区別できません
teach-better = 以前は ± { $before }
teach-worse = 以前は ± { $before }
teach-no-rivals = 似て見える回転はほかにありません。
teach-rival = { $angle }° 回すと { $percent } % 同じに見えます。そこで異なる特徴を選ばないと、回転を誤ることがあります。
teach-far-rival = { $angle }° 回すと { $percent } % 同じに見えますが、区別できます。

## The pictures
teach-tools = 左の画像をタップしたときの動作
teach-choose = 特徴を選ぶ
teach-now-choose = 輪郭または穴の中央をタップします。実線でチェック付きは使用、破線は除外です。
teach-now-reference = 座標を出力する点をタップします。edged はそこにあるものの中心を使います。
teach-now-gripping = グリッパでつかむ位置をタップします。
teach-picture-left = 左の画像。矢印キーで十字を動かし、Enter でタップ、プラスとマイナスでズーム、0 で全体。
teach-picture-right = 右の画像、同じ部分
teach-look = 見る
teach-look-at = { $key } を見る
teach-place-reference = 基準点
teach-place-gripping = 把持点
teach-place-reference-said = 基準点を設定しました。
teach-place-gripping-said = 把持点を設定しました。

## Where the part is
teach-part = ワークの場所
teach-tool-tap = タップ
teach-tool-rectangle = 矩形
teach-tool-circle = 円
teach-tool-polygon = 多角形
teach-tool-brush = 消去
teach-tool-tap-what = ワークをタップすると、領域が輪郭まで広がります。
teach-tool-rectangle-what = 角から角へドラッグするか、両方をタップします。
teach-tool-circle-what = 中心から縁へドラッグするか、両方をタップします。
teach-tool-polygon-what = 角を順にタップし、最初の角をもう一度タップすると閉じます。
teach-tool-brush-what = 影やラベルなど、ワークでない所を塗りつぶします。
teach-cut = くり抜く
teach-place = 中央に置く
teach-close = 閉じる
teach-no-region = まだありません。画像全体が学習されます。
teach-adds = { $kind } { $shape }
teach-cuts = { $kind } { $shape }（くり抜き）
teach-remove = 削除
teach-remove-shape = 図形 { $shape } を削除
teach-shape-rectangle = 矩形
teach-shape-circle = 円
teach-shape-polygon = 輪郭
teach-shape-brush = 消去した線
teach-handle = { $kind } { $shape }、点 { $point }：{ $x }、{ $y } px。矢印キーで動かせます。

## Features
teach-features = 特徴：{ $count } 個中 { $taken } 個を使用
teach-features-what = edged は使用する特徴で測定します。ぼけたもの、ワーク上で動くものは除外してください。
teach-no-features = セルがワークの場所を把握すると表示されます。
teach-take-all = すべて使用
teach-taken-said = { $key } を使用します。
teach-left-said = { $key } を除外しました。
teach-kind-circle = 円
teach-kind-slot = 長穴
teach-kind-edge = エッジ
teach-kind-corner = コーナー
teach-kind-curve = 曲線
teach-size-diameter = Ø { $mm } mm
teach-size-length = 長さ { $mm } mm
teach-size-width = 幅 { $mm } mm
teach-why-not-seen = この画像ペアでは見えません
teach-why-left-out = 手動で除外
teach-warnings = 確認してください
teach-warning-cut = 輪郭が切れています。
teach-warning-round = 円形のため回転がわかりません。
teach-warning-symmetric = 回しても同じに見えます。
teach-warning-confusable = 回してもほぼ同じに見えます。
teach-warning-weak = コントラスト不足：照明を強くするか、横から当ててください。
teach-warning-few-points = エッジが少なめです。より大きい、または鮮明な部分を使うと良くなります。
teach-warning-few-levels = 画像内で小さすぎます。カメラを近づけると良くなります。
teach-warning-lopsided = 一方の方向の精度が他方よりかなり劣ります。
teach-warning-bright-walls = 壁が表面と同じ明るさで、穴が深く見えます。
teach-warning-uneven = 同じ面のエッジの高さがそろいません。
teach-warning-one-pair = 一組の画像では面取りが分かりません。
teach-warning-not-found = 自身の画像の中で再検出できませんでした。

## Points and sizes
teach-reference = 基準点
teach-reference-what = PLC とロボットに座標を送る点。推奨：最も精度の高い点。
teach-reference-tap = 画像でタップする
teach-reference-feature = または次の中心：
teach-gripping = 把持点
teach-gripping-what = グリッパでつかむ位置（基準点と異なる場合）。基準点から、ワーク自身の軸に沿って。
teach-gripping-tap = タップする
teach-gripping-type = 入力する
teach-gripping-none = ほかの位置なし
teach-tray = トレイ
teach-tray-what = ワークがポケットに並ぶ場合：等間隔の行と列。角のポケットに置いたワークの報告位置で決まります。
teach-tray-columns = 列
teach-tray-rows = 行
teach-tray-tolerance = 許容差
teach-tray-first = 最初のポケット
teach-tray-row-end = 最初の行の最後のポケット
teach-tray-column-end = 最後の行の最初のポケット
teach-tray-type = トレイを設定する
teach-tray-none = トレイなし
teach-sizes = 検査する寸法
teach-sizes-what = ワークごとに測定します。基準値 ± 公差を外れると不良です。
teach-size-of = 起点
teach-size-to = 終点
teach-size-kind = 項目
teach-size-witness = 各ワークでキャリブレーションを確認する寸法。常に測定されます。
teach-size-alone = –（自身の寸法）
teach-size-add = この寸法を追加
teach-size-good = 公差内
teach-size-bad = 公差外
teach-size-remove = 寸法 { $name } を削除
teach-nominal = 基準値
teach-tolerance = 公差 ±
teach-measure-radius = 半径
teach-measure-distance = 距離
teach-measure-angle = 角度
teach-measure-width = 幅
teach-measure-length = 長さ
teach-measure-height = 高さ
teach-measure-flatness = 平面度

## Its release
teach-job = ジョブ
teach-name = 名前
teach-name-wrong = 英字、数字、「_」「.」「-」（先頭は英字か数字）
teach-number = PLC での番号
teach-activate = このジョブを使用
teach-try = 先に試す
teach-activate-title = { $name } を使用しますか？
teach-activate-what = 独立したリリースになります。失敗した場合は以前のものが残り、リリースの一覧からも戻せます。
teach-activated = { $name } はリリース { $number } として使用中です。

## What teaches nothing
problem-teach-no-feature = 両方のカメラから見える円、長穴、直線エッジがありません。ワークを両方の前に置き、照明を当て、タップしてください。
problem-teach-one-sided = 左の画像に写っているものが右の画像に見つかりません。ワークは両方のカメラの前にあり、遮るものはありませんか。そうでなければ、キャリブレーションが別のカメラのものです。点検してください。
problem-teach-patterned-table = ワークの周りは穴あきテーブルの穴で、ワーク自身には同軸の円しかなく、回転がわかりません。無地のテーブルに置くか、STEP ファイルを追加してください。
problem-teach-small-region = 選択が空か小さすぎます。ワークをタップするか、周りを囲んでください。
problem-teach-crossing = ワークを囲む線が交差しています。周囲に沿って順に角を置いてください。
problem-teach-few-edges = 選択範囲のエッジが少なすぎます。ワークが入っていて、照明とピントは合っていますか？
problem-teach-nothing-there = そこには明確な輪郭がありません。ワークの周りを囲むか、テーブルと区別できるように照明してください。
problem-teach-no-pair = このジョブは別の場所でティーチングされ、画像ペアがありません。新しいペアでティーチングしてください。
problem-teach-nothing-left = 測定に使うものが残っていません。円 1 つ、長穴 1 つ、またはエッジ 2 本以上を選んでください。
problem-teach-no-pictures = そのサイクルには画像がありません。カメラから届きませんでした。
problem-teach-other-rig = そのサイクルは別のキャリブレーションで測定され、画像の位置関係が今と異なります。新しいサイクルを使ってください。
problem-teach-further-none = 画像ペア { $pair } には、このワーク 1 個の全体が両方の画像に写っていません。撮り直すか、削除してください。
problem-teach-further-little = すべての画像ペアを合わせても、ワークの写りが不足しています。
problem-teach-further-needless = このワークは曲線が少なく、追加の画像ペアからは学習できません。削除してください。
problem-teach-further-size = この画像ペアは最初のものと大きさが異なります。

teach-further = 追加の画像ペア
teach-further-what = 加工された稜線には面取りや丸みがあり、カメラに正対して置いたワークからはその形がわかりません。ワークを 10～40 度傾けるか照明を変えて、その画像ペアを追加してください。
teach-further-add = 画像ペアを追加
teach-further-said = 画像ペアを追加しました。
teach-further-removed = 画像ペアを削除しました。
teach-further-pair = 画像ペア { $number }
teach-further-remove-pair = 画像ペア { $number } を削除
teach-further-open = 稜線の面取りの形は未確定です。各画像から求め直し、その確かさは σ に反映されます。
teach-further-none = 稜線はシャープです。
teach-further-face = 面取り幅 { $width } mm。上面側の稜線をティーチングしました。
teach-further-wall = 面取り幅 { $width } mm。側面側の稜線をティーチングしました。
teach-further-either = 面取り幅 { $width } mm。ティーチングした稜線は上面側か側面側か未確定です。

## A drawing instead of the region
teach-drawing = 図面
teach-drawing-what = カメラから見える面の DXF 図面からもジョブを作れます。寸法は図面のものになり、画像ペアはワークの位置を示します。
teach-drawing-is = { $name } から作成。面は左カメラから { $depth } mm。
teach-drawing-back = ワークをタップするか別の領域を選ぶと、再び画像ペアから作成します。
teach-drawing-more = 単位、距離、レイヤ
teach-drawing-unit = 単位
teach-drawing-unit-own = 図面のとおり
teach-drawing-depth = 面までの距離（空欄：画像ペアから）
teach-drawing-layers = レイヤ（カンマ区切り。空欄：表示中すべて）
teach-drawing-choose = DXF ファイルを選択
teach-drawing-reading = 読み込み中…
teach-drawing-said = { $name } からジョブを作成しました。
problem-teach-drawing-no-dxf = 読み込める DXF 図面ではありません。DXF として書き出し直してください。
problem-teach-drawing-unit = 図面に単位がありません。「単位、距離、レイヤ」で選び、ファイルを選び直してください。
problem-teach-drawing-layer = そのレイヤは図面にありません。あるもの：{ $there }
problem-teach-drawing-large = 1 つのワークの図面ではありません（図形、点、サイズが大きすぎます）。その面だけを書き出してください。
problem-teach-drawing-flat = 図面が平面ではありません。x-y 平面の線として面を書き出してください。
problem-teach-drawing-empty = 図面に閉じた輪郭がありません。線、円弧、円、ポリラインを読み込みます。
problem-teach-drawing-open = 輪郭が開いています（x { $x }、y { $y } mm で終了）。閉じるか、ワークのレイヤを指定してください。
problem-teach-drawing-branch = x { $x }、y { $y } mm で輪郭が閉じません。分岐か二重線があります。直すか、ワークのレイヤを指定してください。
problem-teach-drawing = 図面を使えません：{ $detail }
problem-teach-drawing-depth = 画像ペアから面までの距離がわかりません。左カメラからの距離を入力してください。
problem-teach-drawing-unread = ブラウザがこのファイルを読み込めませんでした。
problem-teach-not-as-drawn = 画像ペアに図面と似たものがありません。カメラから見える面で、鏡像でなく、単位と距離が正しく、両方の画像に全体が写っていますか？
